#!/usr/bin/env bash
# The shipped artifact from nothing: encoder, normals of clouds and of pairs, judge.
set -euo pipefail
cd "$(dirname "$0")/.."
: "${EQUIVALIGN_DATA:?set it to the folder that holds objects/modelnet10.npz and objects/furniture.npz}"
[ -e data ] || ln -s "$EQUIVALIGN_DATA" data
modelnet=data/objects/modelnet10.npz furniture=data/objects/furniture.npz
out=runs/artifact

equivalign fit -c configs/objects.yaml
equivalign export --name objects runs/objects/lightning_logs/version_0/checkpoints/last.ckpt "$out"
equivalign normals "$out" --data "$furniture" --data "$modelnet" --count 4500 --steps 6000
# ModelNet10's clouds are the sparsest: every second pair is one of theirs.
equivalign normals "$out" --of pairs --data "$modelnet" --data "$modelnet" --data "$furniture" \
    --count 6000 --steps 7000 --hidden 32 --memory 12
equivalign calibrate "$out" --data "$furniture" --data "$modelnet" --pairs 2400 --held-out 600
