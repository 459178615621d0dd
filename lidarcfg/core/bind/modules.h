/// What each file of this folder adds to the module.
#pragma once

#include <nanobind/nanobind.h>

namespace lidarcfg::bind {

void bind_maths(nanobind::module_& module);
void bind_viewer(nanobind::module_& module);
void bind_world(nanobind::module_& module);
void bind_simulate(nanobind::module_& module);
void bind_packets(nanobind::module_& module);
void bind_packets_ouster(nanobind::module_& module);
void bind_vsr(nanobind::module_& module);
void bind_vsr_columns(nanobind::module_& module);
void bind_vsr_detection(nanobind::module_& module);
void bind_returns(nanobind::module_& module);

}  // namespace lidarcfg::bind
