"""How accurately a policy throws, with intervals, beside the paper's figures; and what its misses hang on."""
