"""Settings: `params.yaml` as frozen models, one module a part, and strict reading with "did you mean"."""
