"""What a solution gives: fields on particles, and numbers of interest for the history."""
