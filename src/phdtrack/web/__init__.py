"""Pages on which people work with phdtrack: server-rendered, ES modules, nothing from elsewhere."""
