"""The realism ladder as a table and figures."""
