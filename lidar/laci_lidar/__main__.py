"""``python -m laci_lidar``, for environments in which ``laci-lidar`` is not on the path."""

from laci_lidar.start import main

if __name__ == "__main__":
    main()
