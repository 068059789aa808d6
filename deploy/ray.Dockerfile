# The service, batches and training on a cluster of Ray, from the repository's folder:
#   docker build -t equivalign:ray -f deploy/ray.Dockerfile .
ARG RAY=2.60.0
FROM rayproject/ray:${RAY}-py311-cpu
ARG PIP_EXTRA_INDEX_URL=""
USER 0
# Debian and Ubuntu keep only their latest versions, so that pinned ones soon can't be installed.
# hadolint ignore=DL3008
RUN apt-get update \
    && apt-get install -y --no-install-recommends libegl1 libgl1 libgomp1 libidn2-0 libudev1 libusb-1.0-0 libx11-6 \
    && rm -rf /var/lib/apt/lists/*
WORKDIR /build
COPY pyproject.toml constraints.txt README.md LICENSE ./
COPY app app
COPY benchmarks benchmarks
COPY model model
COPY training training
RUN PIP_EXTRA_INDEX_URL="$PIP_EXTRA_INDEX_URL" pip install --no-cache-dir -c constraints.txt '.[las,ray]'
# What the proxies of Serve themselves answer becomes a problem document too.
ENV PYTHONDONTWRITEBYTECODE=1 \
    OMP_WAIT_POLICY=passive \
    NUMBA_CACHE_DIR=/tmp/numba \
    RAY_USAGE_STATS_ENABLED=0 \
    RAY_SERVE_HTTP_PROXY_CALLBACK_IMPORT_PATH=app.ray_proxy.middlewares
USER 1000
WORKDIR /tmp
