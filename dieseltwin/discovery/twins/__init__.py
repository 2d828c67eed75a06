"""What a machine must offer to discovery (`interface`), and the machines that offer it."""
