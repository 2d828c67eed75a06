"""What the paper's evaluation alone needs: its training loops, ensembles and tables. The core never imports it."""
