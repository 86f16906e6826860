#!/usr/bin/env bash
# Measures what docs/results.md shows, and puts the tables there.
#
#   benchmarks/results.sh [FOLDER [STEP...]]     steps: data inhand paper others tables
#                                                (default: all)
#
# FOLDER (default: out/results) takes data sets and results. Every step goes on where it was
# stopped. Results of other code are refused: remove the folder FOLDER/out/* to make them anew, or
# keep it and leave out its step; the tables tell the commit of each. The development frames are not
# part of the repository: link them as FOLDER/data/dev, or do without.
set -euo pipefail

repository=$(cd "$(dirname "$0")/.." && pwd)
command=${INHAND:-$repository/.venv/bin/inhand}
folder=${1:-$repository/out/results}
steps=("${@:2}")
[ ${#steps[@]} -gt 0 ] || steps=(data inhand paper others tables)
mkdir -p "$folder/data"
cd "$folder" # so that the commands, which the tables quote, name no folder of this machine

data() {
  "$command" synth data/synthetic-clean --number 50
  "$command" synth data/synthetic-hard --number 50 --seed 1 --sensor structured_light \
    --visible 0.06 0.25 0.45 0.7 1 --clutter 8 --backdrop 0.05 0.4 \
    --wrist-translation 0.004 --wrist-rotation 0.026
}

inhand() {
  on_synthetic inhand --methods inhand
  on_dev inhand --methods inhand
}

# The slower a method, the fewer frames it gets: every n-th, with n such that all objects, colours
# and ranges of visible shares, which take turns within a scene, get about as many.
paper() {
  on_synthetic paper --methods paper --every 3
  on_dev paper --methods paper
}

others() {
  local fast slow
  fast=$(variants fgr),$(variants fpfh-ransac),$(variants opencv-ppf)
  slow=super4pcs,super4pcs+hs,super4pcs+hs+icp,super4pcs+icp+mask,$(variants kiss-matcher)
  slow+=,icp-from-truth,ablation
  on_synthetic others --methods "$fast,$slow" --every 21
  on_synthetic others --every 7 \
    --methods fgr+hs,fpfh-ransac+hs,opencv-ppf+hs,super4pcs+hs+icp,kiss-matcher+hs
  on_dev others --methods "$fast" --every 3
  on_dev others --methods "$slow" --every 5
}

variants() { echo "$1,$1+hs,$1+mask"; }

on_synthetic() {
  "$command" bench data/synthetic-clean data/synthetic-hard --out "out/synthetic-$1" "${@:2}"
}

on_dev() {
  [ ! -e data/dev ] || "$command" bench data/dev --out "out/dev-$1" "${@:2}"
}

# What follows the mark in docs/results.md is replaced by the report's tables, and by those of its
# figures that docs/figures has already.
tables() {
  "$command" report out/* --out report
  local docs=$repository/docs figure
  for figure in "$docs"/figures/*.svg; do cp "report/figures/${figure##*/}" "$figure"; done
  sed -i '/^<!-- tables/q' "$docs/results.md"
  tail -n +2 report/tables.md | awk -v docs="$docs/" '
    BEGIN { RS = ""; ORS = "\n\n" }
    skip > 0 { skip--; next }
    match($0, /^!\[.*\]\(/) {
      figure = substr($0, RLENGTH + 1, length($0) - RLENGTH - 1)
      if (system("test -e " docs figure)) { skip = 2; next } # its caption, and what made it
    }
    { print }' | sed '$d' >>"$docs/results.md"
}

for step in "${steps[@]}"; do "$step"; done
