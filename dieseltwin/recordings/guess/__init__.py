"""Which of our quantities a foreign channel is: facts, names, units, ranges, physics, and a channel map to edit."""
