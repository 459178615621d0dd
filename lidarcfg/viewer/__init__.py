"""The viewer: a page in the browser or as one file, Open3D's window, and stills without a screen.

To read in this order: `contents` loads what is shown; `rig_source` writes changed poses into a rig's file; `mounting`
checks a rig against its study, `bodies` has subspaces and surfaces as meshes, `evaluation` the figures that the page
shows of a rig, `missed` what it misses. `timeline` has what moves, `colours` and `camera` how it looks. `page` puts
all this on a page and `server` serves it; `still` and `window` draw it without a browser, and `view` is all this in one
call. `web/` is the page's own code.

`__init__.pyi` lists the names. Each loads its module on first use.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
