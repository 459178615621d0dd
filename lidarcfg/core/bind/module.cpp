/// The module: one submodule for each subject.
#include <nanobind/nanobind.h>

#include "bind/modules.h"

namespace {

/// Whether this processor has the instructions of x86-64-v3.
bool has_v3() {
#if defined(__x86_64__)
  return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("bmi") && __builtin_cpu_supports("bmi2") &&
         __builtin_cpu_supports("fma");
#else
  return false;
#endif
}

}  // namespace

NB_MODULE(LIDARCFG_MODULE, module) {
  using namespace lidarcfg::bind;
  nanobind::set_leak_warnings(false);  // what Python's modules still hold at exit is no leak
  module.def("has_v3", &has_v3);
  const auto add = [&](const char* name, void (*bind)(nanobind::module_&)) {
    nanobind::module_ part = module.def_submodule(name);
    bind(part);
  };
  add("maths", &bind_maths);
  add("view", &bind_view);
  add("world", &bind_world);
  add("simulate", &bind_simulate);
  add("packets", &bind_packets);
  add("ouster", &bind_ouster);
  add("placement", &bind_placement);
  add("visibility", &bind_visibility);
  add("returns", &bind_returns);
}
