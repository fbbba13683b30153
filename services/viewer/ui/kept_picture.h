#pragma once

#include <epoxy/gl.h>

#include <opencv2/core.hpp>

namespace splatbus::viewer {

/// What a window shows, without what is drawn over it: to draw that anew while the picture rests, and to be saved. Of
/// the thread whose context is current: OpenGL 3.3.
class KeptPicture {
 public:
  KeptPicture() = default;
  ~KeptPicture();
  KeptPicture(const KeptPicture&) = delete;
  KeptPicture& operator=(const KeptPicture&) = delete;

  /// Framebuffer 0, of that size; where it has no pixels, as of a window that is put away, what was kept stays.
  void keep(int width, int height);
  /// Into framebuffer 0, stretched to that size; black where nothing was kept.
  void restore(int width, int height) const;
  /// CV_8UC3 BGR; empty where nothing was kept.
  [[nodiscard]] cv::Mat read() const;
  /// What another one has read is kept from now on.
  void put(const cv::Mat& picture);

 private:
  void make(int width, int height, const void* bgr);
  GLuint texture_ = 0, framebuffer_ = 0;
  int width_ = 0, height_ = 0;
};

}  // namespace splatbus::viewer
