#!/usr/bin/env bash
# Pin the base image of both images by its present digest: every line ARG BASE=NAME[@sha256:...] of docker/*.Dockerfile
# becomes ARG BASE=NAME@sha256:DIGEST, with the digest of the index over all machines (amd64, arm64).
#
#     docker/pin-base.sh                              # asks the registry, through docker buildx or skopeo
#     docker/pin-base.sh sha256:0123...               # a digest that you already know
set -euo pipefail

folder=$(cd "$(dirname "$0")" && pwd)
name=$(sed -n 's/^ARG BASE=\([^@]*\).*/\1/p' "$folder/companion.Dockerfile" | head -n 1)

ask() { # the digest of the tag, from whichever tool is here
  if docker buildx version >/dev/null 2>&1; then
    docker buildx imagetools inspect "$name" --format '{{.Manifest.Digest}}'
  elif command -v skopeo >/dev/null; then
    skopeo inspect --format '{{.Digest}}' "docker://docker.io/library/$name"
  else
    echo "docker buildx or skopeo is needed to ask for the digest of $name; or name the digest" >&2
    return 1
  fi
}

digest=${1:-$(ask)}
[[ $digest =~ ^sha256:[0-9a-f]{64}$ ]] || { echo "this is no digest: $digest" >&2; exit 1; }
sed -i "s|^ARG BASE=.*|ARG BASE=$name@$digest|" "$folder"/*.Dockerfile
echo "both images build on $name@$digest"
