"""The event-driven solver: from one failing bond to the next without iterations."""
