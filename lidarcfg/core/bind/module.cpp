/// The module: a submodule for each package, and `maths` for lidarcfg/maths.py.
#include <nanobind/nanobind.h>

#include "bind/modules.h"

NB_MODULE(LIDARCFG_MODULE, module) {
  using namespace lidarcfg::bind;
  nanobind::set_leak_warnings(false);  // what Python's modules still hold at exit is no leak
  const auto add = [&](const char* name, void (*bind)(nanobind::module_&)) {
    nanobind::module_ part = module.def_submodule(name);
    bind(part);
  };
  add("maths", &bind_maths);
  add("world", &bind_world);
  add("simulate", &bind_simulate);
  add("packets", &bind_packets);
  add("vsr", &bind_vsr);
  add("returns", &bind_returns);
  add("viewer", &bind_viewer);
}
