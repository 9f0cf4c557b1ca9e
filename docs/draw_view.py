# Copyright 2026 debris_scanner maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Picture of the live view for the README: a simulated scan as a browser shows it while it is tracked.

python docs/draw_view.py PICTURE.png [--simulate TARGET]    (needs Chromium)
"""

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / 'test'))
from browser import Browser, find_chromium

WIDTH, HEIGHT = 1000, 600
COLOURS = 96  # a palette keeps the file small
TRACKING = "document.querySelector('.state')?.textContent === 'tracking'"
# viser warns where there is no graphics card; a reader has one
DISMISS = "document.querySelectorAll('.mantine-Notification-closeButton').forEach(e => e.click())"


def main() -> None:
    """Scan, look, and save what was seen."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('picture', type=Path)
    parser.add_argument('--simulate', default='shuttle_stack')
    args = parser.parse_args()
    chromium = find_chromium()
    if chromium is None:
        sys.exit('no Chromium here')
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, '-m', 'debris_scanner', 'live', '--simulate', args.simulate]
        command += ['--seconds', '90', '--track-seconds', '60', '--spin', '0.8', '--rate', '5']
        command += ['--out', f'{folder}/out', '--view', '0']
        scan = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        assert scan.stderr is not None
        url = next(line.split()[-1] for line in scan.stderr if 'shown at' in line)
        browser = Browser(chromium, Path(folder) / 'profile')
        try:
            browser.visit(url, width=WIDTH, height=HEIGHT)
            browser.wait_for(TRACKING, 240)
            browser.run(DISMISS)
            time.sleep(6)
            shot = Image.fromarray(browser.screenshot())
        finally:
            browser.close()
            scan.terminate()
            scan.communicate()
    shot.quantize(COLOURS, dither=Image.Dither.NONE).save(args.picture, optimize=True)
    print(f'{args.picture}: {args.picture.stat().st_size // 1000} kB')


if __name__ == '__main__':
    main()
