// A square carried from image to image by ViSP's generic model-based tracker: moving edges on its sides, KLT points on
// what is printed in it.

#include <array>
#include <cmath>
#include <cstdlib>
#include <fstream>
#include <iostream>
#include <mutex>
#include <optional>
#include <tuple>
#include <utility>
#include <vector>

#include <unistd.h>

#include "visp_binding.h"

#include <pybind11/stl.h>

#include <visp3/core/vpCameraParameters.h>
#include <visp3/core/vpHomogeneousMatrix.h>
#include <visp3/core/vpTrackingException.h>
#include <visp3/klt/vpKltOpencv.h>
#include <visp3/mbt/vpMbGenericTracker.h>
#include <visp3/me/vpMe.h>

namespace py = pybind11;

namespace {

// ViSP reads models from files only. A square of side 1 serves every size: lengths are in sides.
class SquareModelFile {
public:
  SquareModelFile() {
    const int file = mkstemps(name_.data(), 4);
    if (file < 0) throw std::runtime_error("no temporary file for ViSP's model of a square");
    close(file);
    std::ofstream(name_) << "V1\n4\n-0.5 -0.5 0\n0.5 -0.5 0\n0.5 0.5 0\n-0.5 0.5 0\n0\n0\n1\n4 0 1 2 3\n0\n0\n";
  }
  ~SquareModelFile() { unlink(name_.c_str()); }
  SquareModelFile(const SquareModelFile &) = delete;
  SquareModelFile &operator=(const SquareModelFile &) = delete;
  const std::string &name() const { return name_; }

private:
  std::string name_ = "/tmp/visp-square-XXXXXX.cao";
};

vpHomogeneousMatrix in_sides(const py::array_t<double, py::array::c_style | py::array::forcecast> &T, double size) {
  if (T.ndim() != 2 || T.shape(0) != 4 || T.shape(1) != 4) throw InvalidInput("pose is no matrix (4, 4)");
  if (!(size > 0) || !std::isfinite(size))
    throw InvalidInput("marker size is " + std::to_string(size) + " m, expected more than 0");
  vpHomogeneousMatrix out;
  for (unsigned int i = 0; i < 3; ++i)
    for (unsigned int j = 0; j < 4; ++j) {
      if (!std::isfinite(T.at(i, j))) throw InvalidInput("pose holds a number that is not finite");
      out[i][j] = j == 3 ? T.at(i, j) / size : T.at(i, j);
    }
  if (!(out[2][3] > 0)) throw InvalidInput("pose is not in front of the camera");
  return out;
}

class ModelTracker {
public:
  ModelTracker(bool edges, bool keypoints, unsigned int edge_range_px, double edge_step_px, double edge_threshold,
               int max_keypoints)
      : tracker_(1, (edges ? vpMbGenericTracker::EDGE_TRACKER : 0) | (keypoints ? vpMbGenericTracker::KLT_TRACKER : 0)) {
    if (!edges && !keypoints) throw InvalidInput("neither edges nor keypoints are to be tracked");
    if (edges) {
      vpMe me;
      me.setMaskSize(5);
      me.setMaskNumber(180);
      me.setRange(edge_range_px);
      me.setThreshold(edge_threshold);
      me.setMu1(0.5);
      me.setMu2(0.5);
      me.setSampleStep(edge_step_px);
      tracker_.setMovingEdge(me);
    }
    if (keypoints) {
      vpKltOpencv klt;
      klt.setMaxFeatures(max_keypoints);
      klt.setWindowSize(5);
      klt.setQuality(0.01);
      klt.setMinDistance(4);
      klt.setHarrisFreeParameter(0.01);
      klt.setBlockSize(3);
      klt.setPyramidLevels(3);
      tracker_.setKltOpencv(klt);
      tracker_.setKltMaskBorder(1);
    }
    tracker_.setAngleAppear(vpMath::rad(88));
    tracker_.setAngleDisappear(vpMath::rad(89));
    tracker_.setNearClippingDistance(0.1);
    tracker_.setFarClippingDistance(1000);
    tracker_.setProjectionErrorComputation(true);
    tracker_.setDisplayFeatures(false);
    // ViSP counts what it has read on the standard output.
    std::streambuf *const out = std::cout.rdbuf(nullptr);
    try {
      tracker_.loadModel(SquareModelFile().name());
    } catch (...) {
      std::cout.rdbuf(out);
      throw;
    }
    std::cout.rdbuf(out);  // clears its error too
  }

  void start(const py::array &image, const std::array<double, 4> &intrinsics,
             const py::array_t<double, py::array::c_style | py::array::forcecast> &T, double size) {
    check_image(image);
    const auto [fx, fy, cx, cy] = intrinsics;
    if (!(fx > 0 && fy > 0) || !std::isfinite(fx + fy + cx + cy))
      throw InvalidInput("focal lengths are " + std::to_string(fx) + ", " + std::to_string(fy) + ", expected more than 0");
    const vpHomogeneousMatrix pose = in_sides(T, size);
    const vpImage<unsigned char> view = view_of(image);
    py::gil_scoped_release unlocked;
    const std::lock_guard<std::mutex> one_at_a_time(mutex_);
    size_ = 0;  // stays so where ViSP throws
    tracker_.setCameraParameters(vpCameraParameters(fx, fy, cx, cy));
    tracker_.initFromPose(view, pose);
    height_ = view.getHeight();
    width_ = view.getWidth();
    size_ = size;
  }

  // T_camera_tag, projection error in degrees, number of edge sites and of keypoints; nothing when it is lost.
  std::optional<std::tuple<py::array_t<double>, double, unsigned int, unsigned int>> track(const py::array &image) {
    check_image(image);
    const vpImage<unsigned char> view = view_of(image);
    vpHomogeneousMatrix pose;
    {
      py::gil_scoped_release unlocked;
      const std::lock_guard<std::mutex> one_at_a_time(mutex_);
      if (size_ == 0) throw InvalidInput("the tracker has not been started");
      if (view.getHeight() != height_ || view.getWidth() != width_)
        throw InvalidInput("image is " + std::to_string(view.getWidth()) + " x " + std::to_string(view.getHeight()) +
                           " pixels, the tracker was started with " + std::to_string(width_) + " x " +
                           std::to_string(height_));
      try {
        tracker_.track(view);
      } catch (const vpException &) {  // ViSP's way to say so, of whichever class
        size_ = 0;
        return std::nullopt;
      }
      tracker_.getPose(pose);
    }
    py::array_t<double> T({4, 4});
    auto t = T.mutable_unchecked<2>();
    for (unsigned int i = 0; i < 4; ++i)
      for (unsigned int j = 0; j < 4; ++j) t(i, j) = i < 3 && j == 3 ? pose[i][j] * size_ : pose[i][j];
    return std::make_tuple(std::move(T), tracker_.getProjectionError(), tracker_.getNbFeaturesEdge(),
                           tracker_.getNbFeaturesKlt());
  }

private:
  vpMbGenericTracker tracker_;
  std::mutex mutex_;
  unsigned int height_ = 0, width_ = 0;
  double size_ = 0;  // m; 0 while nothing is tracked
};

}  // namespace

void bind_model_tracker(py::module_ &m) {
  py::class_<ModelTracker>(m, "ModelTracker")
      .def(py::init<bool, bool, unsigned int, double, double, int>(), py::kw_only(), py::arg("edges") = true,
           py::arg("keypoints") = true, py::arg("edge_range_px") = 8, py::arg("edge_step_px") = 3.0,
           py::arg("edge_threshold") = 5000.0, py::arg("max_keypoints") = 60)
      .def("start", &ModelTracker::start, py::arg("image"), py::arg("intrinsics"), py::arg("T_camera_tag"), py::arg("size"),
           "Begin with a square of this size (m) whose pose in the image is known; intrinsics are fx, fy, cx, cy px of an\n"
           "image without distortion.")
      .def("track", &ModelTracker::track, py::arg("image"),
           "T_camera_tag (4, 4), projection error in degrees, edge sites and keypoints used; None when it is lost.");
}
