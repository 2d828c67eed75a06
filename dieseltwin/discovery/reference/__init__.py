"""Learning an engine from recordings of when it was known to be well, by the likelihood that judges it later."""
