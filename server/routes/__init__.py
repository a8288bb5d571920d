"""HTTP routes, one module per resource: they check permissions and bodies and call the parts."""
