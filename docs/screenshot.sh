#!/usr/bin/env bash
# Photograph the screen of a real run: docs/images/live.png and live-zh.png.
# Needs tmux, chromium, fonts-noto-cjk and, in the virtual environment, Pillow.
set -euo pipefail
cd "$(dirname "$0")/.."
folder=$PWD/docs/images scratch=$(mktemp -d)
python=${PYTHON:-$PWD/.venv/bin/python}
trap 'tmux -L fte-sniff-picture kill-server 2>/dev/null || true; rm -rf "$scratch"' EXIT

photograph() { # LANGUAGE NAME
    mkdir -p "$scratch/fte-sniff"
    printf '[screen]\nlanguage = "%s"\n' "$1" >"$scratch/fte-sniff/config.toml"
    tmux -L fte-sniff-picture new-session -d -x 112 -y 32 "cd '$scratch' && env XDG_CONFIG_HOME='$scratch' \
        LC_ALL=C.UTF-8 TEXTUAL_PRESS=wait:12000,E,enter TEXTUAL_SCREENSHOT=16 \
        TEXTUAL_SCREENSHOT_LOCATION='$scratch' TEXTUAL_SCREENSHOT_FILENAME='$2.svg' \
        '$python' -m fte_sniff live 'sim://?weak_motor=3&drop=0.01'"
    while tmux -L fte-sniff-picture has-session 2>/dev/null; do sleep 1; done
    "$python" - "$scratch/$2.svg" <<'PYTHON'
import re, sys
from pathlib import Path
sys.path.insert(0, ".")
from docs.picture import in_cells
path = Path(sys.argv[1])
drawn = in_cells(path.read_text())
path.write_text(re.sub(r"font-family: Fira Code, monospace", "font-family: 'DejaVu Sans Mono', 'Noto Sans Mono CJK SC', monospace", drawn))
print(re.search(r'viewBox="0 0 ([\d.]+) ([\d.]+)', drawn).group(0))
PYTHON
    size=$(grep -om 1 'viewBox="0 0 [0-9]* [0-9]*' "$scratch/$2.svg" | cut -d' ' -f3,4 | tr ' ' ,)
    chromium --headless --no-sandbox --disable-gpu --hide-scrollbars --window-size="$size" \
        --screenshot="$scratch/$2.png" "$scratch/$2.svg" 2>/dev/null
    "$python" -c "from PIL import Image; import sys
Image.open(sys.argv[1]).convert('RGB').quantize(128, dither=0).save(sys.argv[2], optimize=True)" \
        "$scratch/$2.png" "$folder/$2.png"
}

photograph en live
photograph zh live-zh
