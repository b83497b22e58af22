"""Path following: the load factor is an unknown, the growth of a measure is prescribed."""
