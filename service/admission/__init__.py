"""Access control: tokens, scopes, origins, quotas, the memory limit."""
