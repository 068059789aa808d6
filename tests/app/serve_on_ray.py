"""Serves on Ray until its input ends: ``serve_on_ray.py PORT {"/route": settings, …}``.

A line with a route ends the application there.
"""

from __future__ import annotations

import json
import logging
import os
import sys

os.environ["RAY_SERVE_HTTP_PROXY_CALLBACK_IMPORT_PATH"] = "app.ray_proxy.middlewares"

import ray
from ray import serve

from app.ray_deployment import build


def main(port: str, routes: str) -> None:
    ray.init(
        address="local",
        num_cpus=4,
        object_store_memory=256 * 2**20,
        include_dashboard=False,
        log_to_driver=False,
        logging_level=logging.ERROR,
    )
    serve.start(http_options={"host": "127.0.0.1", "port": int(port)})
    for route, settings in json.loads(routes).items():
        serve.run(build(settings), name=f"service{route.replace('/', '-')}", route_prefix=route)
    tell("serving")
    for line in sys.stdin:
        serve.delete(f"service{line.strip().replace('/', '-')}")
        tell("deleted")
    serve.shutdown()
    ray.shutdown()


def tell(what: str) -> None:
    sys.stdout.write(f"{what}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main(*sys.argv[1:])
