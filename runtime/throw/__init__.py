"""The throw protocol on the machine: states, commands, checks; pure."""
