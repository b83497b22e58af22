"""What is solved: body, state, terms of the residual, supports, and the assembly of the tangent."""
