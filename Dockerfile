# The service with the shipped artifact: docker build -t equivalign .

FROM python:3.11-slim AS build
# Another index to find PyTorch's build in; without one, the package index's own build is taken.
ARG PIP_EXTRA_INDEX_URL=""
WORKDIR /build
RUN python -m venv /opt/equivalign
ENV PATH=/opt/equivalign/bin:$PATH
# The dependencies alone first: they change more seldom than the code and weigh much more.
COPY pyproject.toml constraints.txt ./
RUN python -c "import tomllib; print(*tomllib.load(open('pyproject.toml', 'rb'))['project']['dependencies'], sep='\n')" > requirements.txt \
    && PIP_EXTRA_INDEX_URL="$PIP_EXTRA_INDEX_URL" pip install --no-cache-dir -c constraints.txt -r requirements.txt
COPY README.md LICENSE ./
COPY app app
COPY benchmarks benchmarks
COPY model model
COPY training training
RUN pip install --no-cache-dir --no-deps .

FROM python:3.11-slim
RUN apt-get update \
    && apt-get install -y --no-install-recommends libegl1 libgl1 libgomp1 libidn2-0 libudev1 libusb-1.0-0 libx11-6 \
    && rm -rf /var/lib/apt/lists/* \
    && useradd --system --create-home --home-dir /home/equivalign equivalign
COPY --from=build /opt/equivalign /opt/equivalign
# Waiting threads would take the cores from those that work.
ENV PATH=/opt/equivalign/bin:$PATH \
    PYTHONUNBUFFERED=1 \
    OMP_WAIT_POLICY=passive
USER equivalign
WORKDIR /home/equivalign
EXPOSE 8000
HEALTHCHECK --interval=10s --timeout=5s --start-period=60s --retries=3 \
    CMD ["python", "-c", "import os, urllib.request as r; r.urlopen('http://127.0.0.1:' + os.environ.get('EQUIVALIGN_PORT', '8000') + '/readyz', timeout=4)"]
CMD ["equivalign", "serve", "--host", "0.0.0.0"]
