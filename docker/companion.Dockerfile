# Kollsman beside an autopilot: `kollsman` with its compiled code warm, for amd64 and arm64 (a 64-bit Raspberry Pi).
#
#     docker build -f docker/companion.Dockerfile -t kollsman .          # from the repository's root
#
# BASE needs Python 3.11 with venv and Debian's useradd. Both stages use the same one: a venv points at its Python.
ARG BASE=python:3.11-slim-bookworm

FROM ${BASE} AS build
ENV PIP_NO_CACHE_DIR=1 PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_ROOT_USER_ACTION=ignore
WORKDIR /src

# pip and the build backend live in /tools, so that the venv which is shipped holds neither.
COPY docker/*.lock ./
RUN python3 -m venv /tools \
 && /tools/bin/pip install --quiet --require-hashes -r build.lock \
 && python3 -m venv --without-pip /opt/kollsman

# Dependencies are a layer of their own: a change of the code does not download them again. Their versions and hashes
# are in companion.lock (`make lock`). Every base dependency has wheels for both machines, so no compiler. What no one
# runs goes: their tests, and all dialects but the two in use.
RUN /tools/bin/pip --python /opt/kollsman/bin/python install --quiet --only-binary :all: --no-deps --require-hashes -r companion.lock \
 && cd /opt/kollsman/lib/python3.11/site-packages \
 && find . -type d -name tests -prune -exec rm -r {} + \
 && find pymavlink/dialects -type f ! -name '__init__*' ! -name 'ardupilotmega.*py*' ! -name 'common.*py*' -delete

COPY . .
RUN /tools/bin/pip wheel --quiet --no-deps --no-build-isolation --wheel-dir /wheels . \
 && /tools/bin/pip --python /opt/kollsman/bin/python install --quiet --no-deps /wheels/kollsman-*.whl

FROM ${BASE}
RUN useradd --uid 1000 --gid dialout --no-create-home --home-dir /data --shell /usr/sbin/nologin kollsman \
 && install -d -m 1777 /data
COPY --from=build /opt/kollsman /opt/kollsman

# Numba's cache is keyed by the processor: compiled for a generic one, it is warm on every machine the image runs on.
ENV PATH=/opt/kollsman/bin:$PATH PYTHONUNBUFFERED=1 PYTHONDONTWRITEBYTECODE=1 \
    KOLLSMAN_CACHE=/opt/kollsman/cache NUMBA_CPU_NAME=generic TMPDIR=/dev/shm
RUN kollsman warm-up && chmod -R a+rX /opt/kollsman/cache

# uid:gid of kollsman and Debian's dialout, which owns serial ports. Any other uid will do (--user).
USER 1000:20
WORKDIR /data
EXPOSE 14550/udp
ENTRYPOINT ["kollsman"]
CMD ["--help"]
