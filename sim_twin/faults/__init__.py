"""Hidden effects of the virtual machine, written independently of the twin's own."""
