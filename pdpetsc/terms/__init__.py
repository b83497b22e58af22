"""What adds forces: material points, bonds, zero-energy control, dead loads, springs that hold loose particles."""
