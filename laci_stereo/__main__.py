"""``python -m laci_stereo``, where ``laci-stereo`` is not on the path."""

from laci_stereo.start import main

if __name__ == "__main__":
    main()
