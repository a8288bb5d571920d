"""The twin, the virtual machine, rollouts, preview and evaluation campaigns."""
