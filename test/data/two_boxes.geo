// Two boxes of 2 x 1 x 0.5 and 2 x 1 x 1, the upper one on the lower one; one transfinite cell each.
Point(1) = {0, 0, 0};
Point(2) = {2, 0, 0};
Point(3) = {2, 1, 0};
Point(4) = {0, 1, 0};
Line(1) = {1, 2};
Line(2) = {2, 3};
Line(3) = {3, 4};
Line(4) = {4, 1};
Curve Loop(1) = {1, 2, 3, 4};
Plane Surface(1) = {1};
lower[] = Extrude {0, 0, 0.5} { Surface{1}; };
upper[] = Extrude {0, 0, 1} { Surface{lower[0]}; };
Point(100) = {5, 5, 5};  // a node of no tetrahedron
Transfinite Curve {:} = 2;
Transfinite Surface {:};
Transfinite Volume {:};

Physical Volume("lower", 1) = {lower[1]};
Physical Volume(12) = {upper[1]};
Physical Volume("both", 3) = {lower[1], upper[1]};
Physical Surface("bottom face", 4) = {1};
Physical Curve("front", 5) = {1};
Physical Point("origin", 6) = {1};
Physical Point("lost", 7) = {100};
