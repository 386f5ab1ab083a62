"""SU2's config files: the shape that moves a wall, its design variables and its patches."""

from ._config import Config as Config
from ._config import read_config as read_config
from ._motion import DesignVariables as DesignVariables
from ._sensitivity import Sensitivity as Sensitivity
from ._sensitivity import read_sensitivity as read_sensitivity
from ._variables import write_gradient as write_gradient
