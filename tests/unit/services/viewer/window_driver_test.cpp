// A window on a driver without OpenGL 4.5.
#include "viewer/stream_client.h"
#include "window_fixture.h"

namespace splatbus::stream_test {
namespace {

using testing::AllOf;
using testing::HasSubstr;

class OldDriverWindow : public WindowTest {
 protected:
  OldDriverWindow() { offer("4.1", "410"); }
  ~OldDriverWindow() override {
    ::unsetenv("MESA_GL_VERSION_OVERRIDE");
    ::unsetenv("MESA_GLSL_VERSION_OVERRIDE");
  }
  static void offer(const char* opengl, const char* glsl) {
    ::setenv("MESA_GL_VERSION_OVERRIDE", opengl, 1);
    ::setenv("MESA_GLSL_VERSION_OVERRIDE", glsl, 1);
  }
  void expect_to_draw_and_end() {
    EXPECT_THAT(log(), AllOf(HasSubstr("no OpenGL 4.5"), HasSubstr("llvmpipe"), HasSubstr("offers OpenGL 4.1")));
    EXPECT_TRUE(is_seen(save_resting_picture())) << log();
    Display::act("key Escape");
    EXPECT_EQ(viewer_->wait(), 0) << log();
  }
};

TEST_F(OldDriverWindow, ShowsTheModel) {
  start();
  expect_to_draw_and_end();
}

TEST_F(OldDriverWindow, ShowsAReplay) {
  viewer::ClientOptions options = client_options("recorder");
  options.packet_log = directory_.path() + "/packets";
  {
    viewer::StreamClient client(options);
    ASSERT_TRUE(poll_until([&] { return client.replica().count() == kGaussians; }, client));
  }
  start({}, {"--replay", options.packet_log});
  expect_to_draw_and_end();
}

TEST_F(OldDriverWindow, SaysWhatHelpsWhereNoPictureCanBeShown) {
  offer("2.1", "120");
  launch();
  EXPECT_EQ(viewer_->wait(), 1) << log();
  EXPECT_THAT(log(), AllOf(HasSubstr("no window with OpenGL 4.5: "), HasSubstr("no window with OpenGL 3.3: "),
                           HasSubstr("LIBGL_ALWAYS_SOFTWARE=1"), HasSubstr("--set out=FOLDER --set frames=1")));
}

}  // namespace
}  // namespace splatbus::stream_test
