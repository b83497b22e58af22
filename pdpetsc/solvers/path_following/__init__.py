"""Path following: the load factor is an unknown, and the growth of a measure is prescribed."""
