"""HTTP routes of accounts and throwing machines: they check permissions and bodies and call the parts."""
