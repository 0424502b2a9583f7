"""Match photos to a store of places through the Python API: python match_photo.py STORE.h5 PHOTO...

The store is one that `skyline build DEM -o STORE.h5` made. The photos are 60 degrees wide; leave
``fov_deg`` out for photos whose EXIF data has the field of view.
"""

import sys

from skyline import Matcher


def main(store: str, photos: list[str]) -> None:
    with Matcher(store) as matcher:
        for photo in photos:
            result = matcher.match(photo, fov_deg=60.0, top=3)
            for candidate in result.candidates:
                place = f"{candidate.lat:.5f} {candidate.lon:.5f}"
                view = f"heading {candidate.heading_deg:.1f} from true north"
                print(f"{photo}: {place} {view} confidence {candidate.confidence:.2f}")


if __name__ == "__main__":
    if len(sys.argv) < 3:
        sys.exit("usage: python match_photo.py STORE.h5 PHOTO...")
    main(sys.argv[1], sys.argv[2:])
