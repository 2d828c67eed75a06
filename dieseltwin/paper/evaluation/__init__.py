"""The paper's tables and figures from ensembles of every method, and the page with the printed ones beside them."""
