"""What is learned from laboratory data: empirical maps, actuator operators, multi-head bodies."""
