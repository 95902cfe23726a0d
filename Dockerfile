# One image for every service; docker-compose.yml says which one a container is.
FROM python:3.11-slim-bookworm AS build
WORKDIR /src
COPY . .
RUN python -m venv /opt/canskin && /opt/canskin/bin/pip install --no-cache-dir ./client .

FROM python:3.11-slim-bookworm
# Sockets of the virtual buses, and what is worth keeping: compiled kernels and trained classifiers.
RUN useradd --system --uid 10001 --no-create-home --home-dir /var/cache/canskin skin \
    && install --directory --owner=skin --mode=0700 /run/canskin /var/cache/canskin
COPY --from=build /opt/canskin /opt/canskin
ENV PATH=/opt/canskin/bin:$PATH \
    SKIN_BUS_DIR=/run/canskin \
    SKIN_CACHE=/var/cache/canskin \
    NUMBA_CACHE_DIR=/var/cache/canskin/numba \
    MPLCONFIGDIR=/var/cache/canskin/matplotlib \
    OMP_NUM_THREADS=1 \
    OPENBLAS_NUM_THREADS=1 \
    NUMBA_NUM_THREADS=1
USER skin
ENTRYPOINT ["skin"]
