"""``python -m laci_lidar``, where ``laci-lidar`` is not on the path."""

from laci_lidar.start import main

if __name__ == "__main__":
    main()
