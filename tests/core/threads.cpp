/// The kernels on several threads, which share what may be shared: for
/// ThreadSanitizer, see test_threads.py.
///
/// Each kernel runs once on each thread, all of them at the same time, several
/// times over; what they find has to be what one thread finds alone.
#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <functional>
#include <limits>
#include <numbers>
#include <numeric>
#include <random>
#include <thread>
#include <vector>

#include "maths.h"
#include "packets/block_decoder.h"
#include "packets/velodyne.h"
#include "vsr/evaluator.h"
#include "returns/known_returns.h"
#include "simulate/trace.h"
#include "world/tracer.h"
#include "world/world.h"

namespace {

using namespace lidarcfg;

constexpr int threads = 4;
constexpr int rounds = 3;
constexpr double inf = std::numeric_limits<double>::infinity();
constexpr double turn = 2 * std::numbers::pi;

std::mt19937_64 source(1);
double random(double low, double high) { return std::uniform_real_distribution(low, high)(source); }

std::vector<double> randoms(std::size_t count, double low, double high) {
  std::vector<double> out(count);
  for (double& one : out) {
    one = random(low, high);
  }
  return out;
}

void require(bool holds, const char* what) {
  if (!holds) {
    std::printf("%s: threads find something else than one alone\n", what);
    std::exit(1);
  }
}

/// Have all threads begin `work` at once; each returns what it found, which has
/// to be the same.
template <class Found>
void together(const char* what, const std::function<Found(int)>& work) {
  for (int round = 0; round < rounds; ++round) {
    std::atomic<int> ready = 0;
    std::vector<Found> found(threads);
    std::vector<std::thread> all;
    for (int n = 0; n < threads; ++n) {
      all.emplace_back([&, n] {
        ++ready;
        while (ready < threads) {
          std::this_thread::yield();
        }
        found[n] = work(n);
      });
    }
    for (std::thread& one : all) {
      one.join();
    }
    const Found alone = work(0);
    for (const Found& one : found) {
      require(one == alone, what);
    }
  }
}

world::Bvh soup(std::size_t count, double reach_m) {
  std::vector<world::Shape> shapes(count);
  for (world::Shape& shape : shapes) {
    const Vec3 at{random(-reach_m, reach_m), random(-reach_m, reach_m), random(0, 2)};
    for (std::size_t c = 0; c < 9; ++c) {
      shape[c] = at[c % 3] + random(-0.5, 0.5);
    }
  }
  std::vector<std::int32_t> number(count);
  for (std::size_t n = 0; n < count; ++n) {
    number[n] = static_cast<std::int32_t>(n);
  }
  const std::vector<std::int32_t> object(count, 1);
  return world::build(shapes, std::vector<world::Kind>(count, world::Kind::triangle), number, object);
}

/// Rays (3, N) from around the origin.
struct Rays {
  explicit Rays(Index count)
      : origins(randoms(3 * count, -1, 1)), directions(3 * count), seconds(randoms(count, 0, 1)) {
    for (Index n = 0; n < count; ++n) {
      const auto [c, s] = cos_sin(random(0, turn));
      const double up = random(-0.3, 0.3);
      const double flat = std::sqrt(1 - up * up);
      directions[n] = flat * c;
      directions[count + n] = flat * s;
      directions[2 * count + n] = up;
    }
  }

  Index count() const { return std::ssize(seconds); }
  Rows<const double> from() const { return {origins.data(), 3, count()}; }
  Rows<const double> along() const { return {directions.data(), 3, count()}; }

  std::vector<double> origins, directions, seconds;
};

void trace_rays(const world::World& scene) {
  const Rays rays(3000);
  const world::Bvh& tree = scene.fixed();
  together<std::vector<double>>("first_hits", [&](int) {
    std::vector<double> range_m(rays.count());
    std::vector<std::int32_t> slot(rays.count());
    world::first_hits(tree, rays.from(), rays.along(), inf, range_m, slot);
    return range_m;
  });
  together<std::vector<char>>("any_hits", [&](int) {
    std::vector<char> hit(rays.count());
    world::any_hits(tree, rays.from(), rays.along(), {reinterpret_cast<bool*>(hit.data()), hit.size()});
    return hit;
  });
  together<std::vector<double>>("cast", [&](int) {
    std::vector<double> range_m(rays.count());
    std::vector<std::int32_t> slot(rays.count());
    world::cast(scene, rays.from(), rays.along(), rays.seconds, 100.0, {range_m, slot, {}, {}});
    return range_m;
  });
}

void trace_firings(const world::World& scene, const world::Bvh& bodies, std::size_t width) {
  constexpr Index count = 600;
  const std::vector<double> zero(1), one(1, 1.0);
  const std::vector<double> spread = randoms(width, -0.003, 0.003);
  const world::Path path = world::Path::arc(5.0, 0.2, 0.0);
  const world::Pose here{{1, 0, 0, 0, 1, 0, 0, 0, 1}, {0, 0, 1}};
  std::vector<std::int32_t> object(2 + scene.slots() + bodies.size());
  const std::vector<std::uint8_t> reflectivity(3, 50);
  std::vector<std::int64_t> time_ns(count);
  for (Index n = 0; n < count; ++n) {
    time_ns[n] = n * 1'000'000;
  }
  const std::vector<std::uint8_t> laser(count);
  const std::vector<double> encoder_rad = randoms(count, 0, turn);
  const simulate::Stage stage{scene,
                              bodies,
                              {object, reflectivity},
                              {one, zero, one, zero, zero, zero, zero, spread, spread},
                              {here, &path, 0, here},
                              0,
                              100.0};
  together<std::vector<double>>("trace_firings", [&](int) {
    const Index rays = count * static_cast<Index>(width);
    std::vector<double> range_m(rays), cosine(rays);
    std::vector<std::uint8_t> bright(rays);
    std::vector<std::int32_t> hit(rays);
    const Index columns = static_cast<Index>(width);
    simulate::trace_firings(stage, {time_ns, laser, encoder_rad},
                            {{range_m.data(), count, columns},
                             {bright.data(), count, columns},
                             {hit.data(), count, columns},
                             {cosine.data(), count, columns}});
    return range_m;
  });
}

vsr::Grid make_grid() {
  constexpr Index nx = 70;
  constexpr Index ny = 12;
  constexpr Index nz = 4;
  constexpr Index chunks = 2;
  std::vector<double> centres[3];
  for (int axis = 0; axis < 3; ++axis) {
    for (Index n = 0; n < std::array{nx, ny, nz}[axis]; ++n) {
      centres[axis].push_back(static_cast<double>(n) + 0.5);
    }
  }
  std::vector<vsr::Word> included((nz + 2) * (ny + 2) * chunks);
  for (Index k = 1; k <= nz; ++k) {
    for (Index j = 1; j <= ny; ++j) {
      included[(k * (ny + 2) + j) * chunks] = vsr::all_bits;
      included[(k * (ny + 2) + j) * chunks + 1] = vsr::bit(nx - 64) - 1;
    }
  }
  return {centres[0], centres[1], centres[2], included, {1, 1, 1}, {}, {nullptr, 0, 0}};
}

/// Trials of two LiDARs, which threads take from one counter; where `limited`,
/// by what the LiDARs see.
void evaluate(const vsr::Grid& grid, const vsr::Obstacles& obstacles, bool limited) {
  constexpr Index trials = 24;
  constexpr Index lidars = 2;
  constexpr Index columns = 6 + 8;
  constexpr Index certificates = 4;
  const Index rows = grid.rows();
  std::vector<double> cones(trials * lidars * columns);
  for (Index n = 0; n < trials * lidars; ++n) {
    double* const row = cones.data() + n * columns;
    const std::array<double, columns> values{random(20, 50), random(2, 10), random(1, 3), 0,    0,   1,   -0.4,
                                             -0.2,           -0.1,          -0.02,        0.02, 0.1, 0.2, 0.4};
    std::copy(values.begin(), values.end(), row);
  }
  std::vector<double> limits(limited ? trials * lidars * vsr::limit_columns : 0);
  for (std::size_t n = 0; n < limits.size(); n += vsr::limit_columns) {
    limits[n + 1] = 900;
  }
  const vsr::Placed placed{{cones.data(), trials, lidars, columns},
                                 {limits.data(), trials, limited ? lidars : 0, vsr::limit_columns},
                                 obstacles};
  const std::vector<double> bound(trials, inf);
  const std::vector<char> moved(trials * lidars, 1);
  const std::vector<char> same(trials * lidars, 0);
  const Rows<const bool> all{reinterpret_cast<const bool*>(moved.data()), trials, lidars};
  const Rows<const bool> none{reinterpret_cast<const bool*>(same.data()), trials, lidars};
  const std::vector<std::int64_t> zeros(trials);
  const std::vector<std::int64_t> known(trials * certificates, -1);
  const vsr::Batch batch{placed, bound, all, zeros, {known.data(), trials, certificates}, {}, none, {}, 0.0};
  const std::array<char, lidars> both{1, 1};
  const Rows<const bool> cases{reinterpret_cast<const bool*>(both.data()), 1, lidars};
  std::vector<std::int64_t> numbers(trials);
  for (Index n = 0; n < trials; ++n) {
    numbers[n] = n;
  }
  std::vector<double> before;
  for (int round = 0; round < rounds; ++round) {
    for (const int workers : {threads, 1}) {
      std::int64_t next = 0;
      std::int64_t next_source = 0;
      std::vector<double> cost(trials);
      std::vector<std::int64_t> refuted_by(trials), found(trials * certificates);
      std::vector<vsr::Links> links(trials * lidars * rows);
      std::vector<vsr::Word> clear(limited ? trials * lidars * rows : 0);
      const vsr::BatchResult result{cost, refuted_by, {found.data(), trials, certificates}, {}, {}};
      const vsr::Sources sources{numbers,
                                       placed,
                                       all,
                                       none,
                                       {links.data(), trials, lidars, rows},
                                       {clear.data(), limited ? trials : 0, lidars, rows}};
      std::vector<std::thread> team;
      for (int n = 0; n < workers; ++n) {
        team.emplace_back([&] {
          vsr::TrialEvaluator evaluator(grid, cases, certificates);
          evaluator.evaluate_batch({&next, 1}, trials, batch, true, result);
          evaluator.recompute_links({&next_source, 1}, trials, sources);
        });
      }
      for (std::thread& one : team) {
        one.join();
      }
      require(before.empty() || cost == before, "evaluate_batch");
      before = cost;
    }
  }
}

/// Threads share what is known of returns.
void know_returns(const vsr::Obstacles& obstacles) {
  constexpr Index phases = 4;
  constexpr double step_rad = turn / 360 / phases;
  std::vector<double> cos_head, sin_head;
  for (Index n = 0; n < 360 * phases; ++n) {
    const auto [c, s] = cos_sin(static_cast<double>(n) * step_rad);
    cos_head.push_back(c);
    sin_head.push_back(s);
  }
  const std::vector<double> none(3);
  const std::vector<double> elevation{-0.17, 0, 0.17};
  const std::vector<double> start(9);
  const returns::Scanner scanner({cos_head,
                                  sin_head,
                                  0.0,
                                  step_rad,
                                  phases,
                                  none,
                                  none,
                                  none,
                                  elevation,
                                  {start.data(), 3, 3},
                                  {0.5, 100.0},
                                  {0.0, turn}});
  const returns::TargetShape target{soup(40, 0.5), {-1, -1, -0.5}, {1, 1, 2.5}};
  std::vector<returns::Place> places;
  for (int n = 0; n < 60; ++n) {
    places.push_back({{random(-20, 20), random(-20, 20), 0}, 1, 0});
  }
  const std::vector<std::int64_t> scanners{0, 1};
  const auto pose = [](double x) { return returns::SensorPose{{{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}}, {x, 0, 1}}; };
  std::vector<std::int64_t> all(places.size());
  std::iota(all.begin(), all.end(), std::int64_t{0});
  for (const std::int32_t enough : {1, 8, 30, 100, 300}) {
    returns::KnownReturns known({scanner, scanner}, {{target, places}}, obstacles);
    together<std::vector<double>>("missed", [&](int thread) {
      std::vector<double> out(5);
      for (int n = 0; n < 5; ++n) {
        const int number = (n + thread / 2) % 5;  // two threads at the same pose
        const std::vector<returns::SensorPose> poses{pose(0.1 * number), pose(1 - 0.1 * number)};
        const returns::RigAt rig{scanners, poses};
        if (thread % 2 != 0) {
          known.missed_among(rig, 0, enough, 30);
        } else {
          std::vector<std::int32_t> counts(2 * all.size());
          std::vector<std::int8_t> phase(2 * all.size());
          known.lowest(rig, 0, all, enough, 2,
                       {{counts.data(), std::ssize(all), 2}, {phase.data(), std::ssize(all), 2}});
        }
        out[number] = known.missed(rig, 0, enough, inf);
      }
      return out;
    });
    require(known.traced() > 0, "traced");
  }
}

void decode() {
  constexpr Index slots = 32;
  constexpr Index groups = 12;
  constexpr Index count = 40;
  std::vector<std::int64_t> laser(slots), offset_ns(groups * slots);
  for (Index n = 0; n < slots; ++n) {
    laser[n] = n % 16;
  }
  const std::vector<double> fraction = randoms(groups * slots, 0, 1);
  const std::vector<std::uint8_t> kind(slots), ring(16);
  const std::vector<double> angles = randoms(16, -0.2, 0.2);
  const packets::BlockDecoder<packets::Velodyne> decoder(
      {laser, {fraction.data(), groups, slots}, {offset_ns.data(), groups, slots}, kind, {}},
      {angles, angles, angles, angles, angles, angles, ring, {nullptr, 0, 2}, {nullptr, 0, 4}}, 1000, 100, 0.002);
  std::vector<std::uint8_t> bytes(count * packets::Velodyne::packet_bytes);
  for (std::uint8_t& one : bytes) {
    one = static_cast<std::uint8_t>(source() & 255);
  }
  const Rows<const std::uint8_t> data{bytes.data(), count, packets::Velodyne::packet_bytes};
  const std::vector<char> yes(count, 1);
  const View<const bool> wanted{reinterpret_cast<const bool*>(yes.data()), yes.size()};
  const std::vector<std::int64_t> stamp_ns(count), gap_ns(count, 1000);
  const std::vector<std::uint8_t> strongest(count);
  const Index most = decoder.count(data, wanted);
  together<std::vector<Vec3>>("decode", [&](int) {
    std::vector<Vec3> xyz_m(most);
    std::vector<std::int64_t> time_ns(most);
    std::vector<std::uint8_t> bytes_of[4];
    for (std::vector<std::uint8_t>& one : bytes_of) {
      one.resize(most);
    }
    decoder.decode(data, wanted, stamp_ns, gap_ns, strongest,
                   {xyz_m, {}, {}, time_ns, bytes_of[0], bytes_of[1], bytes_of[2], bytes_of[3]});
    return xyz_m;
  });
}

}  // namespace

int main() {
  const world::Bvh car = soup(60, 1.0);
  std::vector<world::Moving> moving;
  for (const double x : {-8.0, 8.0}) {
    world::Moving& one = moving.emplace_back();
    one.bvh = car;
    one.place_m = {x, 3, 0.5};
    one.path = world::Path::arc(8.0, 0.5, 0.0);
    one.speed_m_s = 8.0;
  }
  const world::World scene(0.0, soup(3000, 20.0), moving);
  const world::Bvh bodies = soup(20, 1.0);
  trace_rays(scene);
  trace_firings(scene, bodies, simulate::thin);
  trace_firings(scene, bodies, simulate::wide);
  const world::Bvh hood = soup(30, 2.0);
  const std::vector<double> boxes = world::boxes_of(hood);
  const vsr::Obstacles obstacles{&hood, {boxes.data(), 6, world::shadow_boxes}, {35, 6, 0}, -inf};
  const vsr::Grid grid = make_grid();
  evaluate(grid, obstacles, false);
  evaluate(grid, obstacles, true);
  know_returns(obstacles);
  decode();
  std::puts("every thread found the same");
}
