// Marker detection by ViSP, for Python: hitchhike_ros._visp_tracker.
//
// Only hitchhike_ros.servoing imports this module. It takes the image where NumPy has it (no copy),
// releases the interpreter's lock while ViSP works, and turns every C++ exception into a subclass of
// hitchhike_ros.core.errors.VisionError.

#include <mutex>
#include <string>
#include <utility>
#include <vector>

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include "visp_binding.h"

#include <visp3/core/vpException.h>
#include <visp3/detection/vpDetectorAprilTag.h>

namespace py = pybind11;

namespace {

using Family = vpDetectorAprilTag::vpAprilTagFamily;

// ViSP knows more, but Debian builds it without the large ones.
const std::vector<std::pair<std::string, Family>> families = {
    {"36h11", vpDetectorAprilTag::TAG_36h11},
    {"25h9", vpDetectorAprilTag::TAG_25h9},
    {"16h5", vpDetectorAprilTag::TAG_16h5},
    {"circle21h7", vpDetectorAprilTag::TAG_CIRCLE21h7},
};

Family family_of(const std::string &wanted) {
  std::string known;
  for (const auto &[name, family] : families) {
    if (name == wanted) return family;
    known += (known.empty() ? "" : ", ") + name;
  }
  throw InvalidInput("tag family is '" + wanted + "', expected one of " + known);
}

class TagDetector {
public:
  TagDetector(const std::string &family, float quad_decimate, int threads, bool refine_edges, double sharpening)
      : detector_(family_of(family)) {
    if (!(quad_decimate >= 1.0F))
      throw InvalidInput("quad_decimate is " + std::to_string(quad_decimate) + ", expected at least 1");
    if (threads < 1) throw InvalidInput("threads is " + std::to_string(threads) + ", expected at least 1");
    detector_.setAprilTagQuadDecimate(quad_decimate);
    detector_.setAprilTagNbThreads(threads);
    detector_.setAprilTagRefineEdges(refine_edges);
    detector_.setAprilTagDecodeSharpening(sharpening);
  }

  // Ids (N,) and corners (N, 4, 2) in pixels (column, row).
  std::pair<py::array_t<int>, py::array_t<double>> detect(const py::array &image) {
    check_image(image);
    const vpImage<unsigned char> view = view_of(image);
    std::vector<int> ids;
    std::vector<std::vector<vpImagePoint>> corners;
    {
      py::gil_scoped_release unlocked;
      const std::lock_guard<std::mutex> one_at_a_time(mutex_);
      detector_.detect(view);
      ids = detector_.getTagsId();
      corners = detector_.getTagsCorners();
    }
    const auto n = static_cast<py::ssize_t>(ids.size());
    py::array_t<int> ids_out(n);
    py::array_t<double> corners_out({n, py::ssize_t{4}, py::ssize_t{2}});
    auto id = ids_out.mutable_unchecked<1>();
    auto uv = corners_out.mutable_unchecked<3>();
    for (py::ssize_t i = 0; i < n; ++i) {
      id(i) = ids[i];
      for (py::ssize_t j = 0; j < 4; ++j) {
        uv(i, j, 0) = corners[i][j].get_u();
        uv(i, j, 1) = corners[i][j].get_v();
      }
    }
    return {std::move(ids_out), std::move(corners_out)};
  }

private:
  vpDetectorAprilTag detector_;
  std::mutex mutex_;
};

}  // namespace

PYBIND11_MODULE(_visp_tracker, m) {
  m.doc() = "AprilTags and squares by ViSP and by lines, on NumPy images in place, and their poses.";
  const py::object base = py::module_::import("hitchhike_ros.core.errors").attr("VisionError");
  py::register_exception<InvalidInput>(m, "InvalidInputError", base);
  py::register_exception<vpException>(m, "VispError", base);

  py::class_<TagDetector>(m, "TagDetector")
      .def(py::init<const std::string &, float, int, bool, double>(), py::arg("family") = "36h11", py::kw_only(),
           py::arg("quad_decimate") = 1.0F, py::arg("threads") = 1, py::arg("refine_edges") = true,
           py::arg("decode_sharpening") = 0.25)
      .def("detect", &TagDetector::detect, py::arg("image"),
           "Ids (N,) and corners (N, 4, 2) px, lower left first and counter-clockwise on the tag, in a grey image\n"
           "(H, W) uint8, C-contiguous, read in place.");
  m.def("check_image", &check_image, py::arg("image"), "Raises unless the image is one that the others can read in place.");
  bind_edge_fit(m);
  bind_model_tracker(m);
  bind_square_pose(m);
}
