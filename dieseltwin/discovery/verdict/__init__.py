"""From a finished search to findings, the document, the repaired machine and the words for it."""
