#include <gmock/gmock.h>

#include <thread>

#include "../bus/bus_fixture.h"
#include "run_verb.h"

namespace splatbus::cli {
namespace {

using testing::HasSubstr;
using testing::IsEmpty;
using testing::Not;

class TopicEcho : public bus_test::BusTest {
 protected:
  Ran echo(std::vector<std::string> arguments) {
    arguments.insert(arguments.begin(), {"topic", "echo", "--bus", directory_.address().text()});
    return run_to_end(add_topic_verb, std::move(arguments));
  }
};

TEST_F(TopicEcho, SaysThatNothingIsPublishedThere) {
  bus_test::NumberPublisher publisher(connect("tester"), "test/number");
  // What the broker says of its topics once a second must have this one in it from the first time on.
  bus::Subscriber reader(connect("reader"), {"test/number"});
  for (int k = 0; k < 100 && !reader.receive(std::chrono::milliseconds(100)); ++k)
    bus_test::publish_number(publisher, 1);
  const Ran mistyped = echo({"test/nmuber", "elsewhere/*", "--seconds", "3"});
  EXPECT_EQ(mistyped.status, 1);
  EXPECT_THAT(mistyped.out, IsEmpty());
  EXPECT_THAT(mistyped.err, HasSubstr("nothing has been published on 'test/nmuber'; did you mean 'test/number'?"));
  EXPECT_THAT(mistyped.err, HasSubstr("on 'elsewhere/*'; 'splatbus topic list' shows what has"));
  for (const std::string verb : {"hz", "bw", "delay", "info"}) {
    std::vector<std::string> arguments{"topic", verb, "test/nmuber", "--bus", directory_.address().text()};
    if (verb != "info") arguments.insert(arguments.end(), {"--seconds", "4"});
    const Ran other = run_to_end(add_topic_verb, arguments);
    EXPECT_EQ(other.status, 1) << verb;
    EXPECT_THAT(other.err, HasSubstr("splatbus topic " + verb +
                                     ": nothing has been published on 'test/nmuber'; did you mean 'test/number'?"));
  }
  // A topic that is only silent at the moment is no typing mistake.
  const Ran silent = echo({"test/number", "--seconds", "1"});
  EXPECT_EQ(silent.status, 1);
  EXPECT_THAT(silent.err, IsEmpty());
}

TEST_F(TopicEcho, GoesOnWaitingForWhatMayCome) {
  const auto context = connect("tester");
  const std::jthread later([&] {
    std::this_thread::sleep_for(std::chrono::milliseconds(2500));
    bus_test::NumberPublisher publisher(context, "test/late");
    bus_test::publish_number(publisher, 42, true);
  });
  const Ran late = echo({"test/late", "--once", "--field", "probe_id"});
  EXPECT_EQ(late.status, 0);
  EXPECT_EQ(late.out, "42\n");
  EXPECT_THAT(late.err, HasSubstr("nothing has been published on 'test/late'"));
  const Ran there = echo({"test/late", "--once", "--field", "probe_id"});
  EXPECT_EQ(there.out, "42\n");
  EXPECT_THAT(there.err, Not(HasSubstr("test/late")));
}

}  // namespace
}  // namespace splatbus::cli
