"""Discovery: what physics did the twin leave out? Detect, locate, name, model, prove (docs/discovery.md)."""
