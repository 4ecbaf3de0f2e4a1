"""Records: what was measured, as files, with the code and the weights that it was measured with."""
