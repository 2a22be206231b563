# ffcomp for hosts and Dask workers: docs/INSTALL.md. docker build -t ffcomp . [--build-arg EXTRAS=small,plot]
FROM python:3.13-slim AS build
ARG EXTRAS=small
RUN apt-get update && apt-get install -y --no-install-recommends binutils && rm -rf /var/lib/apt/lists/*
WORKDIR /source
COPY pyproject.toml README.md LICENSE MANIFEST.in ./
COPY gcode gcode
COPY models models
COPY ffcomp ffcomp
COPY scripts/slim scripts/slim
RUN python -m venv --without-pip /opt/ffcomp \
    && pip --no-cache-dir --python /opt/ffcomp/bin/python install ".[${EXTRAS}]" \
    && scripts/slim /opt/ffcomp

FROM python:3.13-slim
COPY --from=build /opt/ffcomp /opt/ffcomp
ENV PATH=/opt/ffcomp/bin:$PATH NUMBA_CACHE_DIR=/opt/compiled FFCOMP_CACHE=/opt/cache FFCOMP_LOG=off
# For the processor of the one who builds; others compile again, into a folder that anybody may write to.
RUN mkdir -m 1777 /opt/compiled /opt/cache && ffcomp warmup && chmod -R a+rwX /opt/compiled /opt/cache
WORKDIR /prints
USER 1000
ENTRYPOINT ["ffcomp"]
CMD ["--help"]
