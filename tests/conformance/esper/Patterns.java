import com.espertech.esper.common.client.EPCompiled;
import com.espertech.esper.common.client.EventBean;
import com.espertech.esper.common.client.configuration.Configuration;
import com.espertech.esper.compiler.client.CompilerArguments;
import com.espertech.esper.compiler.client.EPCompilerProvider;
import com.espertech.esper.runtime.client.EPRuntime;
import com.espertech.esper.runtime.client.EPRuntimeProvider;
import java.io.BufferedOutputStream;
import java.io.DataOutputStream;
import java.io.OutputStream;
import java.lang.management.ManagementFactory;
import java.nio.ByteBuffer;
import java.nio.ByteOrder;
import java.nio.IntBuffer;
import java.nio.file.Files;
import java.nio.file.Path;

/**
 * Evaluates a pattern over events of the types A to E, and tells how long the thread took.
 *
 * <p>Arguments: the file of the events, little-endian int32 rows of second, type and key; the
 * pattern, a select clause of row numbers and a pattern clause; how often it is run; the file of the
 * matches, big-endian int32 row numbers (of the last run). Each run prints a line: events, matches,
 * seconds of processor time.
 */
public final class Patterns {
  private static final String[] TYPES = {"A", "B", "C", "D", "E"};

  public static void main(String[] arguments) throws Exception {
    IntBuffer events =
        ByteBuffer.wrap(Files.readAllBytes(Path.of(arguments[0])))
            .order(ByteOrder.LITTLE_ENDIAN)
            .asIntBuffer();
    int count = events.remaining() / 3;
    Object[][] rows = new Object[count][];
    for (int i = 0; i < count; i++) {
      rows[i] = new Object[] {events.get(3 * i + 2), i};
    }
    int runs = Integer.parseInt(arguments[2]);
    for (int run = 1; run <= runs; run++) {
      boolean isLast = run == runs && arguments.length > 3;
      try (OutputStream out =
          isLast ? Files.newOutputStream(Path.of(arguments[3])) : OutputStream.nullOutputStream()) {
        run(events, rows, arguments[1], "run" + run, out);
      }
    }
  }

  private static void run(
      IntBuffer events, Object[][] rows, String pattern, String name, OutputStream out)
      throws Exception {
    Configuration configuration = new Configuration();
    String[] names = {"key", "row"};
    Object[] types = {int.class, int.class};
    for (String type : TYPES) {
      configuration.getCommon().addEventType(type, names, types);
    }
    configuration.getRuntime().getThreading().setInternalTimerEnabled(false);
    EPCompiled compiled =
        EPCompilerProvider.getCompiler()
            .compile("@name('matches') " + pattern, new CompilerArguments(configuration));
    EPRuntime runtime = EPRuntimeProvider.getRuntime(name, configuration);
    runtime.initialize();
    runtime.getEventService().advanceTime(0);
    String deployment = runtime.getDeploymentService().deploy(compiled).getDeploymentId();
    long[] found = {0};
    try (DataOutputStream data = new DataOutputStream(new BufferedOutputStream(out, 1 << 16))) {
      runtime
          .getDeploymentService()
          .getStatement(deployment, "matches")
          .addListener(
              (added, removed, statement, service) -> {
                for (EventBean match : added) {
                  found[0]++;
                  for (String column : match.getEventType().getPropertyNames()) {
                    write(data, (Integer) match.get(column));
                  }
                }
              });
      long begun = ManagementFactory.getThreadMXBean().getCurrentThreadCpuTime();
      int last = -1;
      for (int i = 0; i < rows.length; i++) {
        int second = events.get(3 * i);
        if (second != last) {
          runtime.getEventService().advanceTime(second * 1000L);
          last = second;
        }
        runtime.getEventService().sendEventObjectArray(rows[i], TYPES[events.get(3 * i + 1)]);
      }
      long taken = ManagementFactory.getThreadMXBean().getCurrentThreadCpuTime() - begun;
      System.out.printf("%d %d %.6f%n", rows.length, found[0], taken / 1e9);
    }
    runtime.destroy();
  }

  private static void write(DataOutputStream data, int row) {
    try {
      data.writeInt(row);
    } catch (java.io.IOException error) {
      throw new java.io.UncheckedIOException(error);
    }
  }
}
