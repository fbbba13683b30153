#pragma once

#include <fcntl.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cstdint>
#include <cstdlib>
#include <fstream>
#include <iterator>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <stdexcept>
#include <string>
#include <vector>

namespace splatbus::display_test {

/// An X server without a screen that anybody sees, whose pixels are in a file of `folder`; mouse and keys are
/// xdotool's. DISPLAY is its, for this process and those that it starts.
class Display {
 public:
  explicit Display(const std::string& folder) : pixels_(folder + "/Xvfb_screen0") {
    std::array<int, 2> pipe{};
    if (::pipe2(pipe.data(), 0) != 0) throw std::runtime_error("pipe");
    const std::string number = std::to_string(pipe[1]);
    pid_ = ::fork();
    if (pid_ == 0) {
      ::prctl(PR_SET_PDEATHSIG, SIGKILL);
      ::close(pipe[0]);
      ::execl(SPLATBUS_XVFB, SPLATBUS_XVFB, "-displayfd", number.c_str(), "-screen", "0", "800x640x24", "-fbdir",
              folder.c_str(), "-nolisten", "tcp", nullptr);
      ::_exit(127);
    }
    ::close(pipe[1]);
    std::string name;
    for (char c = 0; ::read(pipe[0], &c, 1) == 1 && c != '\n';) name += c;
    ::close(pipe[0]);
    if (name.empty()) throw std::runtime_error("Xvfb does not start");
    ::setenv("DISPLAY", (":" + name).c_str(), 1);
  }
  ~Display() {
    ::kill(pid_, SIGKILL);
    ::waitpid(pid_, nullptr, 0);
    ::unsetenv("DISPLAY");
  }
  Display(const Display&) = delete;
  Display& operator=(const Display&) = delete;

  /// CV_8UC3 BGR: the file is an XWD, a header of big-endian words, a color map, and the pixels.
  [[nodiscard]] cv::Mat screen() const {
    std::ifstream file(pixels_, std::ios::binary);
    const std::string bytes((std::istreambuf_iterator<char>(file)), {});
    const auto word = [&](std::size_t index) {
      std::uint32_t value = 0;
      for (std::size_t k = 0; k < 4; ++k) value = value << 8 | static_cast<std::uint8_t>(bytes.at(4 * index + k));
      return value;
    };
    const std::size_t first = word(0) + std::size_t{12} * word(19), stride = word(12);
    const int width = static_cast<int>(word(4)), height = static_cast<int>(word(5));
    if (bytes.size() < first + stride * static_cast<std::size_t>(height))
      throw std::runtime_error("a screen cut short");
    cv::Mat with_padding(height, width, CV_8UC4), picture;
    for (int y = 0; y < height; ++y) {
      std::copy_n(bytes.data() + first + stride * static_cast<std::size_t>(y), std::size_t{4} * with_padding.cols,
                  reinterpret_cast<char*>(with_padding.ptr(y)));
    }
    cv::cvtColor(with_padding, picture, cv::COLOR_BGRA2BGR);
    return picture;
  }

  /// "key m", "mousemove 10 20 click 1": xdotool's own words.
  static void act(const std::string& what) {
    EXPECT_EQ(std::system((std::string(SPLATBUS_XDOTOOL) + " " + what).c_str()), 0) << what;
  }

 private:
  std::string pixels_;
  pid_t pid_ = -1;
};

/// Pixels of the text's color.
inline int count_text(const cv::Mat& screen, const cv::Rect& where) {
  cv::Mat text;
  cv::inRange(screen(where), cv::Scalar::all(250), cv::Scalar::all(255), text);
  return cv::countNonZero(text);
}

}  // namespace splatbus::display_test
