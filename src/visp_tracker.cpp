// Marker detection and pose by ViSP, for Python: hitchhike_ros._visp_tracker.
//
// Only hitchhike_ros.servoing.marker_detector imports this module. It takes the image where NumPy has it (no copy),
// releases the interpreter's lock while ViSP works, and turns every C++ exception into a subclass of
// hitchhike_ros.errors.VisionError.

#include <array>
#include <cmath>
#include <mutex>
#include <string>
#include <utility>
#include <vector>

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include "visp_binding.h"

#include <visp3/core/vpColVector.h>
#include <visp3/core/vpException.h>
#include <visp3/core/vpHomogeneousMatrix.h>
#include <visp3/core/vpPoint.h>
#include <visp3/core/vpRotationMatrix.h>
#include <visp3/core/vpThetaUVector.h>
#include <visp3/detection/vpDetectorAprilTag.h>
#include <visp3/vision/vpPose.h>

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

// The plane's normal and the line of sight span the square-on ambiguity: a small square looks nearly the same when its
// normal is mirrored at the line of sight.
vpHomogeneousMatrix mirrored(const vpHomogeneousMatrix &T) {
  vpColVector sight(T.getTranslationVector()), normal(3);
  sight.normalize();
  for (unsigned int i = 0; i < 3; ++i) normal[i] = T[i][2];
  vpColVector axis = vpColVector::crossProd(normal, sight);
  const double sine = axis.frobeniusNorm();
  if (sine < 1e-6) return T;
  // Twice the angle between the normal and the line of sight, whichever way that points.
  const double cosine = vpColVector::dotProd(normal, sight);
  axis *= 2 * std::atan2(cosine < 0 ? -sine : sine, std::fabs(cosine)) / sine;
  const vpRotationMatrix turn(vpThetaUVector(axis[0], axis[1], axis[2]));
  return vpHomogeneousMatrix(T.getTranslationVector(), turn * T.getRotationMatrix());
}

struct Solution {
  vpHomogeneousMatrix T;
  double residual;  // RMS distance of the projected corners, in normalised coordinates
};

// The pose that fits the corners best and, where there is one, the other local optimum; the better one first.
//
// Lagrange's linear solution refined by virtual visual servoing: of ViSP's methods it is the fastest and the only one
// that reaches the least-squares optimum always (Dementhon's start ends in the mirrored pose in up to a sixth of the views).
std::vector<Solution> solve(const std::array<std::array<double, 2>, 4> &corners, double size) {
  const double h = size / 2;
  const std::array<std::array<double, 2>, 4> square = {{{-h, -h}, {h, -h}, {h, h}, {-h, h}}};
  vpPose pose;
  for (std::size_t i = 0; i < 4; ++i) {
    vpPoint point(square[i][0], square[i][1], 0);
    point.set_x(corners[i][0]);
    point.set_y(corners[i][1]);
    pose.addPoint(point);
  }
  std::vector<Solution> solutions;
  const auto keep = [&](const vpHomogeneousMatrix &T) {
    const double residual = std::sqrt(pose.computeResidual(T) / 4);
    if (std::isfinite(residual) && T[2][3] > 0) solutions.push_back({T, residual});
  };
  vpHomogeneousMatrix T;
  pose.computePose(vpPose::LAGRANGE_VIRTUAL_VS, T);
  keep(T);
  if (solutions.empty()) return solutions;
  vpHomogeneousMatrix other = mirrored(T);
  pose.computePose(vpPose::VIRTUAL_VS, other);
  constexpr double same_rad = 0.02;
  const vpThetaUVector apart(T.getRotationMatrix().t() * other.getRotationMatrix());
  if (apart.getTheta() > same_rad) keep(other);
  if (solutions.size() == 2 && solutions[1].residual < solutions[0].residual) std::swap(solutions[0], solutions[1]);
  return solutions;
}

std::vector<std::pair<py::array_t<double>, double>> square_poses(
    const py::array_t<double, py::array::c_style | py::array::forcecast> &corners, double size) {
  if (corners.ndim() != 2 || corners.shape(0) != 4 || corners.shape(1) != 2)
    throw InvalidInput("corners have shape " + std::string(py::str(py::object(corners.attr("shape")))) +
                       ", expected (4, 2)");
  if (!(size > 0) || !std::isfinite(size))
    throw InvalidInput("marker size is " + std::to_string(size) + " m, expected more than 0");
  std::array<std::array<double, 2>, 4> points{};
  for (py::ssize_t i = 0; i < 4; ++i)
    for (py::ssize_t j = 0; j < 2; ++j) {
      points[i][j] = corners.at(i, j);
      if (!std::isfinite(points[i][j])) throw InvalidInput("corners hold a number that is not finite");
    }
  std::vector<Solution> solutions;
  {
    py::gil_scoped_release unlocked;
    solutions = solve(points, size);
  }
  std::vector<std::pair<py::array_t<double>, double>> out;
  for (const Solution &solution : solutions) {
    py::array_t<double> T({4, 4});
    auto t = T.mutable_unchecked<2>();
    for (unsigned int i = 0; i < 4; ++i)
      for (unsigned int j = 0; j < 4; ++j) t(i, j) = solution.T[i][j];
    out.emplace_back(std::move(T), solution.residual);
  }
  return out;
}

}  // namespace

PYBIND11_MODULE(_visp_tracker, m) {
  m.doc() = "AprilTag detection and pose by ViSP, on NumPy images in place.";
  const py::object base = py::module_::import("hitchhike_ros.errors").attr("VisionError");
  py::register_exception<InvalidInput>(m, "InvalidInputError", base);
  py::register_exception<vpException>(m, "VispError", base);

  m.def("square_poses", &square_poses, py::arg("corners"), py::arg("size"),
        "Poses of a square from its four corners (4, 2) in normalised, undistorted image coordinates, lower left first\n"
        "and counter-clockwise: a list, best first, of (T_camera_tag (4, 4), RMS residual). One or two of them (the\n"
        "square-on ambiguity), none when no pose in front of the camera fits. Tag frame: x right, y up, z towards the\n"
        "viewer; size is the side in m.");
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
