#!/bin/sh
# Render the reference skylines of a list of viewpoints and say what is in the store.
# usage: render_batch.sh DEM VIEWPOINTS.csv STORE.h5
set -eu
if [ $# -ne 3 ]; then
    echo "usage: render_batch.sh DEM VIEWPOINTS.csv STORE.h5" >&2
    exit 2
fi
skyline info "$1"
skyline render "$1" --viewpoints "$2" -o "$3" --width 640
skyline info "$3"
