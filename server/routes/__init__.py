"""HTTP: one module a noun; they check rights and shapes and call the services, nothing more."""
