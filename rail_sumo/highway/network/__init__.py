"""What a user's files say: networks, demand, configurations."""
