"""Where the tasks of a campaign run: in this process, in several, or on a Dask cluster."""
