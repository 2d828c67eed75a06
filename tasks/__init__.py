"""One unit of work each: load, call the library once, save, log.

Order is in ``flows``, arithmetic in ``dieseltwin``.
"""
