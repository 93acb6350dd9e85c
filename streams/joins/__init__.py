"""join, object by object or not, and mediation."""
