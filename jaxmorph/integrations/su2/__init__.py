"""SU2's config files as shapes."""

from jaxmorph.extend import listing as _listing

from ._config import Config as Config
from ._config import Sensitivity as Sensitivity
from ._config import read_config as read_config
from ._config import read_sensitivity as read_sensitivity
from ._config import write_gradient as write_gradient
from ._motion import DesignVariables as DesignVariables
from ._options import read_options as read_options
from ._shims import write_shims as write_shims

__dir__ = _listing(globals())
