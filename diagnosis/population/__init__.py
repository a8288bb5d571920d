"""Population of healthy machines: estimation of the model from their throws, and its fit to one machine."""
