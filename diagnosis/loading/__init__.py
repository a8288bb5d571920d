"""Reading and checking of throw logs: motion on one clock, and the residual vector's layout."""
