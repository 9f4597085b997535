"""The report page: one HTML file that shows a calibration, the data that it is based on, and its uncertainty."""

from laci_stereo.report.page.page import Made, write_page
from laci_stereo.report.page.photo import MOMENTS, Photograph, Photographs

__all__ = ["MOMENTS", "Made", "Photograph", "Photographs", "write_page"]
