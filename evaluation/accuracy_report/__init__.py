"""The accuracy report: what is thrown for it, its drawings and its page."""
