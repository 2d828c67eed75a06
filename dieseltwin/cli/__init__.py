"""The command line: `app` puts the commands together, one module a command; each calls the library once."""
