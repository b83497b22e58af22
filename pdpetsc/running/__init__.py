"""Running a case: build its problem, solve the load steps, write the record, and end in order after errors."""
