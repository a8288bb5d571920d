"""Objects around a machine, and impacts of loads on them."""
