% Two bars that cross in a vertical plane, four strings around them, no dampers.
a = pi/4;  len = 5;
N = [0  len*cos(a)  len*cos(a)  0; ...
     0  0  0  0;
     0  0  len*sin(a)  len*sin(a)];
fixedNodes = [1 1 1; 1 1 1; 0 1 0; 0 1 0]';   % a node's coordinates, 1 where held
Cb = [-1 0 1 0; 0 -1 0 1];
Cs = [-1 1 0 0; 0 -1 1 0; 0 0 -1 1; 1 0 0 -1];
tData = tensegConstruct(N, Cb, Cs, fixedNodes);
strings.r = 1/1000*ones(1,tData.nStr);
strings.E = 7e7*ones(1,tData.nStr);
strings.rLP = [1 0.7 1 0.7];
bars.r = 0.05*ones(1,tData.nBar); bars.rho = 500*ones(1,tData.nBar);
g = [0;0;0];
tData.damper = zeros(1,tData.nStr);
tEnd = 10;
disp('a text with a quote''s end, and % no comment');
if tEnd > 5
    note = 1;
end
