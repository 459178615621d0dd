#include "bind/arguments.h"
#include "bind/modules.h"
#include "viewer/raster.h"

namespace lidarcfg::bind {

using Corners = Shaped<Rows<const Vec3>, -1, 3>;

void bind_viewer(nb::module_& module) {
  def(
      module, "blend_triangles",
      [](Shaped<Tables<float>, -1, -1, 3> image, Rows<const float> depth_m, Corners triangles, View<const Vec3> colours,
         View<const double> alpha, double focal_px, double near_m) {
        require(image.tables() == depth_m.rows() && image.rows() == depth_m.columns(), "image: of another size");
        require(std::ssize(colours) == triangles.rows(), "colours: one for each triangle");
        require(std::ssize(alpha) == triangles.rows(), "alpha: one for each triangle");
        return viewer::blend_triangles(image, depth_m, triangles, colours, alpha, focal_px, near_m);
      },
      "Blend triangles (T, 3, 3), far to near, into image (H, W, 3) where they are nearer than depth_m (H, W).",
      "image", "depth_m", "triangles", "colours", "alpha", "focal_px", "near_m");
}

}  // namespace lidarcfg::bind
