"""What minimises the least-squares problem: separable search, PSO-LM as published, and the choice between them."""
