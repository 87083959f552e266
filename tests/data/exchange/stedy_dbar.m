% A square of four bars with its diagonals as strings.
N = [0 1 1 0; 0 0 0 0; 0 0 1 1];
fixedNodes = [1 1 1; zeros(3,3)]';
C = [1 0 0 -1; -1 1 0 0; 0 -1 1 0; 0 0 -1 1; 0 -1 0 1; -1 0 1 0];
nBar = 4;
nStr = size(C,1) - nBar;
bars.index = 1:nBar;
strings.index = nBar+1:nBar+nStr;
Cb = C(bars.index,:);
Cs = C(strings.index,:);
strings.r = 1/1000*ones(1,nStr); strings.E = 7e7*ones(1,nStr);
strings.rLP = [1 0.7];
bars.rho = 500*ones(1,nBar); bars.r = 1/100*ones(1,nBar);
g = [0;0;0];
tData.damper = ones(1,nStr)*0.1;
tEnd = 4;
