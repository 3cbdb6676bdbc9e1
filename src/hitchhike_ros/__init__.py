"""Hitchhiking for mobile robots: one robot rides behind another and saves its own navigation."""

from pkgutil import extend_path

# In catkin's devel space the compiled modules lie in another folder. A spawned process finds this folder first.
__path__ = extend_path(__path__, __name__)
