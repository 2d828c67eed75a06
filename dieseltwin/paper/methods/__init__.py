"""The paper's own estimators, one module each, as `identification.methods`."""
