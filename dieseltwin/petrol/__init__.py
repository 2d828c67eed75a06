"""A twin of a turbocharged petrol engine's air path (throttle, wastegate, no EGR), and discovery on its balances."""
