// What the sources of hitchhike_ros._visp_tracker share: how arguments are refused, and images read in place.

#pragma once

#include <stdexcept>
#include <string>

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <visp3/core/vpImage.h>

// An argument that ViSP could not use; the message says which one and what was expected.
struct InvalidInput : std::invalid_argument {
  using std::invalid_argument::invalid_argument;
};

// Smaller images than this hold no tag, and the quad detector's threshold tiles do not fit into them.
constexpr pybind11::ssize_t min_side_px = 16;

// Refuses what would have to be converted: a silent copy of every frame is what this module is there to avoid.
inline void check_image(const pybind11::array &image) {
  if (!image.dtype().is(pybind11::dtype::of<unsigned char>()))
    throw InvalidInput("image has dtype " + std::string(pybind11::str(image.dtype())) + ", expected uint8 (grey)");
  if (image.ndim() != 2)
    throw InvalidInput("image has " + std::to_string(image.ndim()) + " dimensions, expected 2: (height, width)");
  if (image.shape(0) < min_side_px || image.shape(1) < min_side_px)
    throw InvalidInput("image is " + std::to_string(image.shape(1)) + " x " + std::to_string(image.shape(0)) +
                       " pixels, expected at least " + std::to_string(min_side_px) + " each way");
  if (!(image.flags() & pybind11::array::c_style))
    throw InvalidInput("image is not C-contiguous; it is read in place, so hand over a contiguous one");
}

// A view of a checked image. ViSP only reads the bitmap; its constructor takes it without const. The caller's reference
// keeps it alive.
inline vpImage<unsigned char> view_of(const pybind11::array &image) {
  auto *pixels = static_cast<unsigned char *>(const_cast<void *>(image.data()));
  return {pixels, static_cast<unsigned int>(image.shape(0)), static_cast<unsigned int>(image.shape(1)), false};
}

// The part of the module in model_tracker.cpp.
void bind_model_tracker(pybind11::module_ &m);
// The part of the module in edge_fit.cpp.
void bind_edge_fit(pybind11::module_ &m);
// The part of the module in square_pose.cpp.
void bind_square_pose(pybind11::module_ &m);
