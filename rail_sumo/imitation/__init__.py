"""How a supervisor is learned."""
