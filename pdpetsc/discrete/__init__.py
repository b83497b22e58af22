"""Distributed particle cloud: partition, ghosts, halo exchange, families and the sparsity of matrices."""
