"""Terms: materials at gradient points, bonds, control, dead loads, heat conduction."""
