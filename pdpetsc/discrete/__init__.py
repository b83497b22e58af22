"""The distributed particle cloud: partition, ghosts, halo exchange, families and matrix pattern."""
