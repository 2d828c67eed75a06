"""Finding the health parameters of a diesel engine from a recording; one module a method in `methods`."""
