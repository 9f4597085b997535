"""The report page: one file that shows a calibration, what it rests on and how far it can be trusted."""

from laci_stereo.report.page.page import Made, write_page
from laci_stereo.report.page.photo import MOMENTS, Photograph, Photographs

__all__ = ["MOMENTS", "Made", "Photograph", "Photographs", "write_page"]
