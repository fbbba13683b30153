#include <gmock/gmock.h>
#include <sys/stat.h>

#include "bus/error.h"
#include "bus/permanent_error.h"
#include "bus_fixture.h"
#include "child_process.h"
#include "fake_broker.h"
#include "slab_helpers.h"

namespace splatbus::bus_test {
namespace {

using testing::HasSubstr;
using testing::ThrowsMessage;

/// Brokers as processes, to be killed.
class Restart : public testing::Test {
 protected:
  std::unique_ptr<ChildProcess> start_broker() {
    return std::make_unique<ChildProcess>(
        "splatbus-bus", std::vector<std::string>{"--bus", directory_.address().text()}, output_path());
  }
  [[nodiscard]] std::string output_path() const { return directory_.path() + "/output"; }
  std::shared_ptr<bus::Context> connect(const std::string& source) {
    return bus::Context::create(directory_.address(), source);
  }

  TemporaryDirectory directory_;
};

TEST_F(Restart, EverythingGoesOnAfterTheBrokerWasKilled) {
  auto broker = start_broker();
  const auto maker = connect("maker");
  const auto slab = maker->create_slab("model", 1, 1000);
  NumberPublisher model(maker, "grid/state");
  NumberPublisher publisher(maker, "viewer/probe");
  bus::Subscriber subscriber(connect("reader"), {"viewer/probe"});
  meet(publisher, subscriber);
  publish_number(model, 5, true, "", {write_floats(*slab, {1, 2, 3})});

  broker->send(SIGKILL);
  broker->wait();
  broker = start_broker();

  // The publisher does nothing for it: the latched message and the slab are there again.
  bus::Subscriber late(connect("late"), {"grid/state"});
  const auto message = late.receive(patience);
  ASSERT_TRUE(message.has_value());
  EXPECT_EQ(number_of(*message), 5u);
  std::optional<bus::TensorView> view;
  ASSERT_TRUE(eventually([&] { return (view = message->tensor("values")).has_value(); }));
  EXPECT_EQ(view->as<float>()[2], 3.0F);

  // Publishers and subscribers of before go on.
  ASSERT_TRUE(eventually([&] {
    publish_number(publisher, 6);
    const auto number = receive_number(subscriber, 20ms);
    return number == 6u;
  }));
}

TEST_F(Restart, WhatIsPublishedWhileTheBrokerIsAwayWaits) {
  auto broker = start_broker();
  const auto maker = connect("maker");
  NumberPublisher publisher(maker, "viewer/probe");
  {
    bus::Subscriber subscriber(connect("reader"), {"viewer/probe"});
    meet(publisher, subscriber);
  }
  broker->send(SIGKILL);
  broker->wait();
  ASSERT_TRUE(eventually([&] { return !maker->wait_connected(0ms); }));
  NumberPublisher latched(maker, "grid/state");
  publish_number(latched, 8, true);
  broker = start_broker();
  bus::Subscriber subscriber(connect("reader"), {"grid/state"});
  EXPECT_EQ(receive_number(subscriber), 8u);
}

TEST_F(Restart, WhatWaitedForABrokerComesInTheOrderInWhichItWasPublished) {
  const auto maker = connect("maker");
  NumberPublisher probes(maker, "viewer/probe"), state(maker, "grid/state");
  for (std::uint64_t number = 0; number < 6; ++number) {
    const bool latched = number % 2 == 1;
    publish_number(latched ? state : probes, number, latched, latched ? std::to_string(number) : "");
  }
  FakeReader broker(directory_.address());
  std::vector<std::uint64_t> heard;
  while (heard.size() < 6) {
    const std::vector<std::string> frames = broker.receive();
    ASSERT_GE(frames.size(), 2U) << "nothing has come";
    if (frames[0] != "viewer/probe" && frames[0] != "grid/state") continue;
    heard.push_back(flatbuffers::GetRoot<wire::ViewerProbe>(frames[1].data())->probe_id());
  }
  EXPECT_THAT(heard, testing::ElementsAre(0, 1, 2, 3, 4, 5));
}

TEST_F(Restart, ASlabOutlivesItsMaker) {
  const auto broker = start_broker();
  auto maker = std::make_unique<ChildProcess>(
      "bus-test-service", std::vector<std::string>{"--bus", directory_.address().text()}, output_path() + "2");
  const auto context = connect("reader");
  bus::Subscriber subscriber(context, {"test/model"});
  ASSERT_TRUE(subscriber.receive(patience).has_value());
  maker->send(SIGKILL);
  EXPECT_EQ(maker->wait(), -SIGKILL);

  // A process that never saw the maker reads what it left, and its successor goes on with it.
  const auto late = connect("late");
  bus::Subscriber late_subscriber(late, {"test/model"});
  const auto message = late_subscriber.receive(patience);
  ASSERT_TRUE(message.has_value());
  EXPECT_EQ(number_of(*message), 7u);
  std::optional<bus::TensorView> view;
  ASSERT_TRUE(eventually([&] { return (view = message->tensor("values")).has_value(); }));
  float values[3] = {};
  EXPECT_TRUE(view->copy(values));
  EXPECT_EQ(values[2], 3.0F);
  const auto adopted = late->adopt_slab("test/model");
  ASSERT_NE(adopted, nullptr);
  write_floats(*adopted, {4, 5, 6});
  EXPECT_FALSE(view->still_valid());
}

/// The broker in this process, its writers as processes.
class Leases : public testing::Test {
 protected:
  Leases() : broker_({.address = directory_.address(), .slab_grace = 100ms}) { broker_.start(); }

  std::unique_ptr<ChildProcess> start_maker(const std::string& output) {
    return std::make_unique<ChildProcess>(
        "bus-test-service", std::vector<std::string>{"--bus", directory_.address().text()}, directory_.path() + output);
  }
  [[nodiscard]] bool has_slabs(std::size_t count) {
    return eventually([&] { return broker_.statistics().slabs == count; });
  }

  TemporaryDirectory directory_;
  bus_service::Broker broker_;
};

TEST_F(Leases, OneLiveProcessAloneWritesTheSlabsOfASource) {
  const auto first = start_maker("/first");
  ASSERT_TRUE(has_slabs(2));
  const auto second = start_maker("/second");
  EXPECT_EQ(second->wait(), 1);
  EXPECT_THAT(read_text(directory_.path() + "/second"),
              testing::AllOf(HasSubstr("was refused"), HasSubstr("'test'"), HasSubstr(std::to_string(first->pid()))));
  const auto thief = bus::Context::create(directory_.address(), "thief");
  EXPECT_THAT([&] { (void)thief->adopt_slab("test/model"); }, ThrowsMessage<bus::Error>(HasSubstr("was refused")));
  // Its successor is welcome.
  first->send(SIGKILL);
  first->wait();
  const auto third = start_maker("/third");
  EXPECT_TRUE(eventually([&] { return read_text(directory_.path() + "/third").find("test on") != std::string::npos; }));
  EXPECT_NE(eventually([&] { return broker_.statistics().slabs == 2; }), false);
}

TEST_F(Leases, OnlyWhatIsForASuccessorOutlivesItsMaker) {
  for (int life = 0; life < 3; ++life) {
    const auto maker = start_maker("/maker");
    ASSERT_TRUE(has_slabs(2));
    maker->send(SIGKILL);
    maker->wait();
    ASSERT_TRUE(has_slabs(1));
  }
  EXPECT_NE(bus::Context::create(directory_.address(), "test")->adopt_slab("test/model"), nullptr);
}

TEST_F(Restart, ARemovedFolderLetsNoSecondBrokerStartAndTheFirstEnds) {
  const auto folder = directory_.path() + "/bus";
  const auto address = bus::Address::parse("ipc://" + folder);
  auto first = std::make_unique<bus_service::Broker>(bus_service::BrokerOptions{.address = address});
  first->start();
  EXPECT_TRUE(first->intact());
  std::filesystem::remove_all(folder);
  EXPECT_FALSE(first->intact());
  bus_service::Broker second({.address = address});
  EXPECT_THAT([&] { second.start(); },
              ThrowsMessage<bus::Error>(testing::AllOf(HasSubstr("already"), HasSubstr(std::to_string(::getpid())))));
  first.reset();
  second.start();
  // As a process it ends, for its supervisor to start it again.
  ChildProcess process("splatbus-bus", {"--bus", directory_.address().text()}, directory_.path() + "-output");
  ASSERT_TRUE(connect("somebody")->wait_connected(patience));
  std::filesystem::remove(directory_.path() + "/lock");
  EXPECT_EQ(process.wait(), 1);
  EXPECT_THAT(read_text(directory_.path() + "-output"), HasSubstr("was removed"));
  std::filesystem::remove(directory_.path() + "-output");
}

TEST_F(Restart, AFolderThatOthersCanEnterIsClosedOrRefused) {
  const auto make = [&](const std::string& name, mode_t mode) {
    const auto folder = directory_.path() + "/" + name;
    EXPECT_EQ(::mkdir(folder.c_str(), 0700), 0);
    EXPECT_EQ(::chmod(folder.c_str(), mode), 0);
    return folder;
  };
  const auto mode_of = [](const std::string& folder) {
    struct stat status {};
    ::lstat(folder.c_str(), &status);
    return status.st_mode & 07777U;
  };
  const auto open = make("open", 0755);
  bus_service::Broker broker({.address = bus::Address::parse("ipc://" + open)});
  broker.start();
  EXPECT_EQ(mode_of(open), 0700U);
  for (const char* socket : {"/xsub", "/xpub", "/slabs", "/lock"})
    EXPECT_EQ(mode_of(open + socket) & 077U, 0U) << socket;
  // One that is something else is left alone.
  const auto home = make("home", 0755);
  std::filesystem::create_directory(home + "/letters");
  const auto home_bus = bus::Address::parse("ipc://" + home);
  EXPECT_THAT([&] { bus_service::Broker({.address = home_bus}).start(); },
              ThrowsMessage<bus::Error>(testing::AllOf(HasSubstr(home), HasSubstr("0700"))));
  EXPECT_THAT([&] { (void)bus::Context::create(home_bus, "somebody"); }, ThrowsMessage<bus::Error>(HasSubstr("0700")))
      << "who connects looks too";
  EXPECT_EQ(mode_of(home), 0755U);
  // Nor is a link followed.
  const auto link = directory_.path() + "/link";
  std::filesystem::create_directory_symlink(open, link);
  EXPECT_THAT([&] { (void)bus::Context::create(bus::Address::parse("ipc://" + link), "somebody"); },
              ThrowsMessage<bus::Error>(HasSubstr("not a folder")));
  // Who connects first makes it, so that nobody else does.
  const auto missing = directory_.path() + "/missing";
  const auto early = bus::Context::create(bus::Address::parse("ipc://" + missing), "early");
  EXPECT_EQ(mode_of(missing), 0700U);
}

TEST_F(Restart, AnotherUsersFolderIsRefused) {
  if (::geteuid() != 0) GTEST_SKIP() << "only root can give a folder away";
  const auto folder = directory_.path() + "/theirs";
  ASSERT_EQ(::mkdir(folder.c_str(), 0700), 0);
  ASSERT_EQ(::chown(folder.c_str(), 12345, 12345), 0);
  const auto address = bus::Address::parse("ipc://" + folder);
  EXPECT_THAT([&] { bus_service::Broker({.address = address}).start(); },
              ThrowsMessage<bus::Error>(HasSubstr("another user (12345)")));
  EXPECT_THAT([&] { (void)bus::Context::create(address, "somebody"); },
              ThrowsMessage<bus::Error>(HasSubstr("another user (12345)")));
}

TEST_F(Restart, ASecondBrokerIsRefused) {
  bus_service::Broker first({.address = directory_.address()});
  first.start();
  bus_service::Broker second({.address = directory_.address()});
  EXPECT_THAT([&] { second.start(); },
              ThrowsMessage<bus::Error>(testing::AllOf(HasSubstr(directory_.path()), HasSubstr("already"),
                                                       HasSubstr(std::to_string(::getpid())))));
  const auto process = start_broker();
  EXPECT_EQ(process->wait(), bus::kExitPermanent);  // nobody need start it again
  EXPECT_THAT(read_text(output_path()), HasSubstr("a broker runs there already"));
  // The first was not disturbed.
  NumberPublisher publisher(connect("maker"), "viewer/probe");
  bus::Subscriber subscriber(connect("reader"), {"viewer/probe"});
  meet(publisher, subscriber);
  publish_number(publisher, 1);
  EXPECT_EQ(receive_number(subscriber), 1u);
  first.stop();
  second.start();
}

TEST_F(Restart, TheFolderIsPrivate) {
  const auto address = bus::Address::parse("ipc://" + directory_.path() + "/new/bus");
  bus_service::Broker broker({.address = address});
  broker.start();
  struct stat status {};
  ASSERT_EQ(::stat((directory_.path() + "/new/bus").c_str(), &status), 0);
  EXPECT_EQ(status.st_mode & 0777U, 0700U);
}

TEST_F(Restart, BadBrokerFlagsAreExplained) {
  struct Case {
    std::vector<std::string> arguments;
    int status;
    const char* text;
  };
  const Case cases[] = {
      {{"--bus", "tcp://127.0.0.1:5000"}, 2, "a broker's own bus is ipc:///folder"},
      {{"--bus", "ipc:///proc/none/bus"}, 1, "/proc/none/bus"},
      {{"--bus", directory_.address().text(), "--tcp", "nohost"}, 2, "nohost"},
      {{"--bus", directory_.address().text(), "--tcp", "no.such.interface:5000"}, 78, "no.such.interface"}};
  for (const auto& [arguments, status, text] : cases) {
    ChildProcess process("splatbus-bus", arguments, output_path());
    EXPECT_EQ(process.wait(), status) << text;
    EXPECT_THAT(read_text(output_path()), HasSubstr(text));
  }
}

}  // namespace
}  // namespace splatbus::bus_test
