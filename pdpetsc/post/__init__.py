"""Post-processing of a solution: fields on particles, and quantities of interest for the history."""
