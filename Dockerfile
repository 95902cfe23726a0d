# One image for every service; docker-compose.yml says which one a container is. docs/containers.md tells the rest.
ARG BASE=python:3.11-slim-bookworm
FROM ${BASE} AS build
# A folder of wheels beside this file (`make wheels`): pip then asks no index, and the build needs no network.
ARG WHEELS=
WORKDIR /src
COPY . .
# By the environment, so that the lock holds in the isolated builds of our own packages, too.
ENV PIP_CONSTRAINT=/src/requirements.lock
RUN python -m venv /opt/canskin \
    && /opt/canskin/bin/pip install --no-cache-dir ${WHEELS:+--no-index --find-links "/src/$WHEELS"} ./client ".[metrics]"

FROM ${BASE}
# Sockets of the virtual buses and of the hub, and what is worth keeping: compiled kernels, trained classifiers, the zero.
RUN useradd --system --uid 10001 --no-create-home --home-dir /var/cache/canskin skin \
    && install --directory --owner=skin --mode=0700 /run/canskin /var/cache/canskin
COPY --from=build /opt/canskin /opt/canskin
ENV PATH=/opt/canskin/bin:$PATH \
    XDG_RUNTIME_DIR=/run \
    SKIN_BUS_DIR=/run/canskin \
    SKIN_CACHE=/var/cache/canskin \
    NUMBA_CACHE_DIR=/var/cache/canskin/numba \
    MPLCONFIGDIR=/var/cache/canskin/matplotlib \
    OMP_NUM_THREADS=1 \
    OPENBLAS_NUM_THREADS=1 \
    NUMBA_NUM_THREADS=1
USER skin
# The whole chain compiles its kernels, for the processor of this machine, and trains the default skin's classifier.
RUN skin demo --seconds 1 --no-view --picture /tmp/demo.png && rm /tmp/demo.png
# A service that makes no progress for 10 s ends itself, and its container is started again (docs/containers.md).
ENV WATCHDOG_USEC=10000000
# A new volume begins with what the image has there; a container without any volume gets one of its own.
VOLUME /var/cache/canskin
# Layouts, calibrations and models are named relative to the folder that is mounted here.
WORKDIR /etc/canskin
ENTRYPOINT ["skin"]
