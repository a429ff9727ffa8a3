"""One driven vehicle: what it senses, how it follows, changes lanes and crosses junctions."""
