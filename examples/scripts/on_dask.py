"""A campaign on the workers of a Dask cluster, here of this computer; a notebook needs no ``if``."""

from distributed import LocalCluster

import hil

if __name__ == "__main__":
    with LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as cluster:
        print(hil.campaign("scheme-1", runs=10, scheduler=cluster.scheduler_address))
