"""Cut the demo recording out of the full table: five minutes, the thirty aircraft heard most.

    python examples/cut_slice.py quickstart.csv.gz examples/adsb.csv.gz

Only aircraft that are in the air for the whole five minutes are taken. The output is the same
bytes every time.
"""

import csv
import gzip
import io
import sys
from collections import Counter

START = 1_633_615_801_000  # 2021-10-07T14:10:01Z, ms since the epoch
END = START + 5 * 60_000
AIRCRAFT = 30


def main(source: str, target: str) -> None:
    with gzip.open(source, "rt", newline="") as file:
        reader = csv.DictReader(file)
        columns = list(reader.fieldnames or ())
        rows = [row for row in reader if START <= int(row["timestamp"]) < END]
    grounded = {row["icao24"] for row in rows if row["onground"] != "False"}
    heard = Counter(row["icao24"] for row in rows if row["icao24"] not in grounded)
    chosen = {icao24 for icao24, _ in heard.most_common(AIRCRAFT)}
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(row for row in rows if row["icao24"] in chosen)
    with open(target, "wb") as raw, gzip.GzipFile("", "wb", 9, raw, mtime=0) as packed:
        packed.write(text.getvalue().encode())


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit("usage: python cut_slice.py quickstart.csv.gz TARGET.csv.gz")
    main(*sys.argv[1:])
