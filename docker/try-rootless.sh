#!/usr/bin/env bash
# Build both images and fly the compose demo with them where no Docker engine runs: with buildah, podman and runc, on
# the host's loopback, at this machine's limits, with no privilege given to the containers.
#
#     docker/try-rootless.sh
#
# It needs buildah, podman, runc and conmon (Debian: apt-get install buildah podman runc), and debootstrap unless BASE
# names an image that can be pulled. All it makes is in $CONTAINERS, and kept for the next run; remove that folder to start over.
set -euo pipefail

CONTAINERS=${CONTAINERS:-/var/tmp/kollsman-containers} # images and the base system: 3 GB, 7 GB with the vfs driver
DRIVER=${DRIVER:-}                                      # overlay or vfs; found out
BASE=${BASE:-}                                          # image to build on; none: a Debian made by debootstrap
SCENARIO=${SCENARIO:-weather-change}
SPEED=${SPEED:-20}
PORT=${PORT:-14550}
LIMIT_S=${LIMIT_S:-300} # for the flight

repository=$(cd "$(dirname "$0")/.." && pwd)
logs=$CONTAINERS/logs
containers=()

say() { printf '\n== %s\n' "$*"; }

fail() {
  printf 'FAIL: %s\n' "$*" >&2
  exit 1
}

clean_up() {
  for id in ${containers[@]+"${containers[@]}"}; do
    pod rm --force --time 5 "$id" >/dev/null 2>&1 || true
  done
}
trap clean_up EXIT

storage() { # the options that buildah and podman share
  printf '%s\n' --root "$CONTAINERS/storage" --runroot "$CONTAINERS/run" --storage-driver "$DRIVER"
}

pod() { podman "${storage[@]}" --runtime runc --cgroup-manager cgroupfs "$@"; }

can_overlay() { # whether this user may mount an overlay file system here
  local there=$CONTAINERS/overlay-test status=0
  mkdir -p "$there"/{lower,upper,work,merged}
  mount -t overlay overlay -o "lowerdir=$there/lower,upperdir=$there/upper,workdir=$there/work" "$there/merged" \
    2>/dev/null || status=1
  [ "$status" = 1 ] || umount "$there/merged"
  rm -rf "$there"
  return "$status"
}

make_base() { # a Debian with Python 3.11, as python:3.11-slim-bookworm is; from where this machine's apt gets its packages
  local tree=$CONTAINERS/tree mirror
  [ "$(id -u)" = 0 ] || fail "debootstrap needs root; or name an image to build on in BASE"
  mirror=$(apt-get indextargets --format '$(SITE)' 'Codename: bookworm' | head -n 1)
  rm -rf "$tree"
  debootstrap --variant=minbase --include=python3,python3-venv,ca-certificates bookworm "$tree" ${mirror:+"$mirror"} \
    >"$logs/debootstrap.log" 2>&1 || fail "debootstrap: see $logs/debootstrap.log"
  rm -rf "$tree"/var/cache/apt/* "$tree"/var/lib/apt/lists/* "$tree"/usr/share/{doc,man,locale,info}/* "$tree"/var/log/*
  tar -C "$tree" --numeric-owner -c . | pod import --quiet - "$BASE"
  rm -rf "$tree"
}

build() { # build NAME DOCKERFILE
  local options=(--isolation chroot --layers --format docker --build-arg "BASE=$BASE")
  for path in /etc/ssl/certs /usr/local/share/ca-certificates /etc/pip.conf; do # how this machine reaches its package registry
    [ ! -e "$path" ] || options+=(--volume "$path:$path:ro")
  done
  say "building $1"
  time buildah "${storage[@]}" bud "${options[@]}" --file "$repository/docker/$2" --tag "localhost/$1" "$repository" \
    >"$logs/build-$1.log" 2>&1 || {
    tail -n 30 "$logs/build-$1.log" >&2
    fail "$1 does not build; all of it in $logs/build-$1.log"
  }
}

start() { # start IMAGE COMMAND...: prints the container's id. Confined as in compose.yaml, and as a uid nobody knows.
  pod run --detach --network host --pids-limit 0 --ulimit nofile=1024:1024 --ulimit nproc=1000:1000 \
    --read-only --read-only-tmpfs=false --cap-drop all --security-opt no-new-privileges --user 12345:20 "$@"
}

mkdir -p "$CONTAINERS" "$logs"
[ -n "$DRIVER" ] || { can_overlay && DRIVER=overlay || DRIVER=vfs; }
CONTAINERS=$CONTAINERS/$DRIVER
mkdir -p "$CONTAINERS"
mapfile -t storage < <(storage)

if [ -z "$BASE" ]; then
  BASE=localhost/kollsman-base:bookworm
  if pod image exists "$BASE"; then
    say "base image: $BASE, made before"
  else
    say "base image: making $BASE with debootstrap (a minute)"
    make_base
  fi
fi

build kollsman companion.Dockerfile
build kollsman-sim sim.Dockerfile
say "images (storage driver $DRIVER)"
pod images --filter dangling=false

say "companion: kollsman run udpin:127.0.0.1:$PORT"
companion=$(start localhost/kollsman run "udpin:127.0.0.1:$PORT")
containers+=("$companion")
echo "container $companion"

say "sim: kollsman-sim fly $SCENARIO --link udpout:127.0.0.1:$PORT --speed $SPEED"
sim=$(start localhost/kollsman-sim fly "$SCENARIO" --link "udpout:127.0.0.1:$PORT" --speed "$SPEED")
containers+=("$sim")
echo "container $sim"

status=$(timeout "$LIMIT_S" podman "${storage[@]}" wait "$sim") || status="still flying after $LIMIT_S s"
running=$(pod inspect --format '{{.State.Running}}' "$companion")
pod stop --time 10 "$companion" >/dev/null
left=$(pod inspect --format '{{.State.ExitCode}}' "$companion")
pod logs "$companion" >"$logs/companion.log" 2>&1
pod logs "$sim" >"$logs/sim.log" 2>&1

say "companion's log"
tail -n 25 "$logs/companion.log"
say "sim's log"
tail -n 25 "$logs/sim.log"

say "checks"
[ "$status" = 0 ] || fail "the simulator's exit code is not 0: $status"
[ "$running" = true ] || fail "the companion ended during the flight, exit code $left"
[ "$left" = 0 ] || fail "the companion did not stop cleanly on SIGTERM: exit code $left"
grep -qE '^OK +-?[0-9.]+ m ' "$logs/companion.log" || fail "the companion never said that its health is OK"
altitudes=$(grep -oE '1/191:.*' "$logs/sim.log" | grep -oE '\bALTITUDE [0-9]+' | grep -oE '[0-9]+' || echo 0)
[ "$altitudes" -gt 100 ] || fail "the simulator heard $altitudes ALTITUDE messages of the companion"
echo "PASS: flown, health OK, $altitudes ALTITUDE messages heard by the vehicle"
