"""Many independent units of work on threads, processes or a Dask cluster: always the same bits."""
