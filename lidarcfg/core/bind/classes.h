/// The classes that are bound. Objects of all others are taken by value, as `From` makes them.
#pragma once

namespace lidarcfg {

namespace packets {
template <class Maker>
class BlockDecoder;
namespace hesai {
class Decoder;
}
}  // namespace packets

namespace vsr {
class Grid;
class TrialEvaluator;
}  // namespace vsr

namespace returns {
class KnownReturns;
class Scanner;
struct TargetShape;
}  // namespace returns

namespace world {
struct Bvh;
class Path;
class World;
}  // namespace world

namespace bind {

template <class T>
constexpr bool is_bound = false;

template <class Maker>
constexpr bool is_bound<packets::BlockDecoder<Maker>> = true;
template <>
constexpr bool is_bound<packets::hesai::Decoder> = true;
template <>
constexpr bool is_bound<vsr::Grid> = true;
template <>
constexpr bool is_bound<vsr::TrialEvaluator> = true;
template <>
constexpr bool is_bound<returns::KnownReturns> = true;
template <>
constexpr bool is_bound<returns::Scanner> = true;
template <>
constexpr bool is_bound<returns::TargetShape> = true;
template <>
constexpr bool is_bound<world::Bvh> = true;
template <>
constexpr bool is_bound<world::Path> = true;
template <>
constexpr bool is_bound<world::World> = true;

}  // namespace bind
}  // namespace lidarcfg
