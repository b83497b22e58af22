// A quarter of a plate with a hole:  gmsh -2 -format msh41 gmsh_hole.geo
SetFactory("OpenCASCADE");
length = 15; width = 10; radius = 2;   // of the quarter, mm
Rectangle(1) = {0, 0, 0, length, width};
Disk(2) = {0, 0, 0, radius};
BooleanDifference(3) = { Surface{1}; Delete; }{ Surface{2}; Delete; };

hole[] = Curve In BoundingBox {-0.1, -0.1, -0.1, radius + 0.1, radius + 0.1, 0.1};
right[] = Curve In BoundingBox {length - 0.1, -0.1, -0.1, length + 0.1, width + 0.1, 0.1};
Physical Surface("plate") = {3};
Physical Curve("hole") = {hole[]};
Physical Curve("right") = {right[]};

// Triangles are small at the hole and grow away from it.
Field[1] = Distance;  Field[1].CurvesList = {hole[]};  Field[1].Sampling = 200;
Field[2] = Threshold; Field[2].InField = 1;
Field[2].SizeMin = 0.08; Field[2].SizeMax = 0.9; Field[2].DistMin = 0.1; Field[2].DistMax = 8;
Background Field = 2;
Mesh.MeshSizeExtendFromBoundary = 0;
Mesh.MeshSizeFromPoints = 0;
