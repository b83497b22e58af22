"""Running a case: building its problem, marching, keeping records, and ending in order whatever happens."""
