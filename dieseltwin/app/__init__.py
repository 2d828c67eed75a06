"""The page to work with: `dieseltwin app`. A recording is dropped, its channels are mapped, an engine is chosen, the
verdict is read.

Every file of somebody else's is opened in a worker process alone, with limits on time and memory; the server only
keeps it, under a name of its own. The library is called through its front door, `dieseltwin.api`.
"""
