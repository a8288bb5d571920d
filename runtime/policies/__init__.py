"""Policy versions on a machine's disk: two slots a mode, transfer from the server, rollback without one."""
