#include "viewer/ui/kept_picture.h"

namespace splatbus::viewer {

KeptPicture::~KeptPicture() {
  if (texture_ == 0) return;
  glDeleteFramebuffers(1, &framebuffer_);
  glDeleteTextures(1, &texture_);
}

void KeptPicture::make(int width, int height, const void* bgr) {
  if (texture_ == 0) {
    glGenTextures(1, &texture_);
    glGenFramebuffers(1, &framebuffer_);
  }
  width_ = width;
  height_ = height;
  glBindFramebuffer(GL_DRAW_FRAMEBUFFER, framebuffer_);
  glBindTexture(GL_TEXTURE_2D, texture_);
  glPixelStorei(GL_UNPACK_ALIGNMENT, 1);
  glTexImage2D(GL_TEXTURE_2D, 0, GL_RGB8, width, height, 0, GL_BGR, GL_UNSIGNED_BYTE, bgr);
  glFramebufferTexture2D(GL_DRAW_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, GL_TEXTURE_2D, texture_, 0);
}

void KeptPicture::put(const cv::Mat& picture) {
  cv::Mat bottom_up;
  cv::flip(picture, bottom_up, 0);
  make(bottom_up.cols, bottom_up.rows, bottom_up.data);
  glBindFramebuffer(GL_FRAMEBUFFER, 0);
}

void KeptPicture::keep(int width, int height) {
  if (width <= 0 || height <= 0) return;
  if (texture_ == 0 || width != width_ || height != height_) make(width, height, nullptr);
  glBindFramebuffer(GL_DRAW_FRAMEBUFFER, framebuffer_);
  glBindFramebuffer(GL_READ_FRAMEBUFFER, 0);
  glBlitFramebuffer(0, 0, width, height, 0, 0, width, height, GL_COLOR_BUFFER_BIT, GL_NEAREST);
  glBindFramebuffer(GL_FRAMEBUFFER, 0);
}

void KeptPicture::restore(int width, int height) const {
  glBindFramebuffer(GL_FRAMEBUFFER, 0);
  if (texture_ == 0) {
    glClearColor(0, 0, 0, 1);
    glClear(GL_COLOR_BUFFER_BIT);
    return;
  }
  glBindFramebuffer(GL_READ_FRAMEBUFFER, framebuffer_);
  glBlitFramebuffer(0, 0, width_, height_, 0, 0, width, height, GL_COLOR_BUFFER_BIT, GL_LINEAR);
  glBindFramebuffer(GL_FRAMEBUFFER, 0);
}

cv::Mat KeptPicture::read() const {
  if (texture_ == 0) return {};
  cv::Mat bottom_up(height_, width_, CV_8UC3, cv::Scalar::all(0)), picture;
  glBindFramebuffer(GL_READ_FRAMEBUFFER, framebuffer_);
  glPixelStorei(GL_PACK_ALIGNMENT, 1);
  glReadPixels(0, 0, width_, height_, GL_BGR, GL_UNSIGNED_BYTE, bottom_up.data);
  glBindFramebuffer(GL_FRAMEBUFFER, 0);
  cv::flip(bottom_up, picture, 0);
  return picture;
}

}  // namespace splatbus::viewer
