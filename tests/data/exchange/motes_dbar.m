n1 = [-1 0 0]'; n2 = [0 -1 0]'; n3 = [1 0 0]'; n4 = [0 1 0]';
N_simple = [n1 n2 n3 n4];
C_b = tenseg_ind2C([4 1; 1 2; 2 3; 3 4], N_simple);
C_s = tenseg_ind2C([2 4; 1 3], N_simple);
pinned_nodes = [1];
[N_new,C_b_new,C_s_new,P,D] = tenseg_class_k_convert(N_simple,C_b,C_s,pinned_nodes);
test.N = N_new;
test.s_0 = [1; 0.5];
test.tf = 5;
