"""What adds forces: materials at gradient points, bonds, control, dead loads, springs that hold loose particles."""
