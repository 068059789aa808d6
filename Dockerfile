# The service with the shipped artifact, as a user without rights:
#   docker build -t equivalign .
# PyTorch's build is the package index's own unless PIP_EXTRA_INDEX_URL names an index of wheels for
# the CPU only, which are several gigabytes smaller. For a GPU:
#   docker build -t equivalign:gpu --build-arg VARIANT=gpu --build-arg PIP_EXTRA_INDEX_URL=… .
# What the image holds, as CycloneDX in ./sbom.json:
#   docker build --target sbom --output . .
ARG PYTHON=3.11

FROM python:${PYTHON}-slim AS build
ARG PIP_EXTRA_INDEX_URL=""
ARG VARIANT=cpu
WORKDIR /build
RUN python -m venv /opt/equivalign
ENV PATH=/opt/equivalign/bin:$PATH
# The dependencies alone first: they change more seldom than the code and weigh much more.
COPY pyproject.toml constraints.txt ./
RUN python -c "import tomllib; project = tomllib.load(open('pyproject.toml', 'rb'))['project']; print(*project['dependencies'], *project['optional-dependencies']['las'], sep='\n')" > requirements.txt \
    && PIP_EXTRA_INDEX_URL="$PIP_EXTRA_INDEX_URL" pip install --no-cache-dir -c constraints.txt -r requirements.txt \
    && python -c "import sys, torch; sys.exit('$VARIANT' == 'gpu' and torch.version.cuda is None and 'VARIANT=gpu needs PIP_EXTRA_INDEX_URL with CUDA wheels of PyTorch')"
COPY README.md LICENSE ./
COPY app app
COPY benchmarks benchmarks
COPY model model
COPY training training
RUN pip install --no-cache-dir --no-deps .

FROM build AS list
RUN python -m venv /opt/list \
    && /opt/list/bin/pip install --no-cache-dir -c constraints.txt cyclonedx-bom \
    && /opt/list/bin/cyclonedx-py environment --output-file /sbom.json /opt/equivalign

FROM scratch AS sbom
COPY --from=list /sbom.json /sbom.json

FROM python:${PYTHON}-slim AS service
# Debian keeps only its latest versions, so that pinned ones soon can't be installed.
# hadolint ignore=DL3008
RUN apt-get update \
    && apt-get install -y --no-install-recommends libegl1 libgl1 libgomp1 libidn2-0 libudev1 libusb-1.0-0 libx11-6 \
    && rm -rf /var/lib/apt/lists/* \
    && useradd --uid 10001 --no-create-home --home-dir /nonexistent --shell /usr/sbin/nologin equivalign
COPY --from=build /opt/equivalign /opt/equivalign
# Waiting threads would take the cores from those that work. Nothing is written but /tmp.
ENV PATH=/opt/equivalign/bin:$PATH \
    PYTHONDONTWRITEBYTECODE=1 \
    PYTHONUNBUFFERED=1 \
    OMP_WAIT_POLICY=passive \
    EQUIVALIGN_HOST=0.0.0.0 \
    EQUIVALIGN_PORT=8000 \
    NVIDIA_VISIBLE_DEVICES=all \
    NVIDIA_DRIVER_CAPABILITIES=compute,utility
USER 10001
WORKDIR /tmp
EXPOSE 8000
STOPSIGNAL SIGTERM
HEALTHCHECK --interval=10s --timeout=5s --start-period=120s --retries=3 \
    CMD ["python", "-c", "import os, urllib.request as r; r.urlopen('http://127.0.0.1:' + os.environ['EQUIVALIGN_PORT'] + '/readyz', timeout=4)"]
CMD ["equivalign", "serve"]
