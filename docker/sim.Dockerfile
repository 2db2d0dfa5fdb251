# The simulator: `kollsman-sim`, JSBSim speaking MAVLink, for amd64 and arm64.
#
#     docker build -f docker/sim.Dockerfile -t kollsman-sim .            # from the repository's root
ARG BASE=python:3.11-slim-bookworm

# JSBSim has a wheel for amd64 and none for Linux on arm64: there it is compiled, in a stage that is thrown away.
# `--build-arg JSBSIM=compile` compiles it anywhere.
FROM ${BASE} AS jsbsim
ARG JSBSIM=auto
ENV PIP_NO_CACHE_DIR=1 PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_ROOT_USER_ACTION=ignore
RUN python3 -m venv /tools
COPY docker/jsbsim.lock ./
RUN if [ "$JSBSIM" = compile ] || [ "$(uname -m)" != x86_64 ]; then \
      apt-get update \
      && apt-get install -y --no-install-recommends g++ cmake make \
      && { [ -e "$(python3 -c 'import sysconfig; print(sysconfig.get_path("include"))')/Python.h" ] \
           || apt-get install -y --no-install-recommends python3-dev; } \
      && CMAKE_BUILD_PARALLEL_LEVEL="$(nproc)" \
         /tools/bin/pip wheel --no-deps --no-binary jsbsim --require-hashes --wheel-dir /wheels -r jsbsim.lock; \
    else \
      /tools/bin/pip wheel --quiet --no-deps --only-binary jsbsim --require-hashes --wheel-dir /wheels -r jsbsim.lock; \
    fi

FROM ${BASE} AS build
ENV PIP_NO_CACHE_DIR=1 PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_ROOT_USER_ACTION=ignore
WORKDIR /src
COPY docker/*.lock ./
RUN python3 -m venv /tools \
 && /tools/bin/pip install --quiet --require-hashes -r build.lock \
 && python3 -m venv --without-pip /opt/kollsman
COPY --from=jsbsim /wheels /wheels
RUN /tools/bin/pip --python /opt/kollsman/bin/python install --quiet --only-binary :all: --no-deps --require-hashes -r sim.lock \
 && /tools/bin/pip --python /opt/kollsman/bin/python install --quiet --no-deps /wheels/jsbsim-*.whl \
 && cd /opt/kollsman/lib/python3.11/site-packages \
 && find . -type d -name tests -prune -exec rm -r {} + \
 && find pymavlink/dialects -type f ! -name '__init__*' ! -name 'ardupilotmega.*py*' ! -name 'common.*py*' -delete
COPY . .
RUN /tools/bin/pip wheel --quiet --no-deps --no-build-isolation --wheel-dir /wheels . \
 && /tools/bin/pip --python /opt/kollsman/bin/python install --quiet --no-deps /wheels/kollsman-*.whl

FROM ${BASE}
RUN useradd --uid 1000 --user-group --no-create-home --home-dir /data --shell /usr/sbin/nologin kollsman \
 && install -d -m 1777 /data
COPY --from=build /opt/kollsman /opt/kollsman
# TMPDIR: writable even where the root file system is not.
ENV PATH=/opt/kollsman/bin:$PATH PYTHONUNBUFFERED=1 PYTHONDONTWRITEBYTECODE=1 \
    TMPDIR=/dev/shm MPLCONFIGDIR=/dev/shm/matplotlib MPLBACKEND=Agg
RUN kollsman-sim list
USER 1000:1000
WORKDIR /data
ENTRYPOINT ["kollsman-sim"]
CMD ["list"]
