"""Write the corpus: one run of a servo motor in the layouts of tools and instruments.

    python tests/logs/write_corpus.py

Each function writes one layout; its docstring names the source. The run comes from
`fluxobs.simulation.closed_form`: machine "servo-400w", sampled at 5 kHz; the voltage of a row acts
until the next row.
"""

from __future__ import annotations

import gzip
import struct
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import polars as pl

from fluxobs.machines import example, rotating
from fluxobs.simulation.closed_form.signals import driven

FOLDER = Path(__file__).with_name("corpus")
MACHINE, SAMPLE_TIME, ROWS = "servo-400w", 2e-4, 600
Array = np.ndarray


def run() -> dict[str, Array]:
    """Return the true signals in SI: time, vectors in αβ, phases and dq, and angle."""
    machine = rotating(example(MACHINE))
    substeps = 16
    fine = np.arange(ROWS * substeps + 1) * SAMPLE_TIME / substeps
    speed = 420.0 + 120.0 * np.sin(2 * np.pi * fine / 0.1)
    i_q = 4.0 + 2.0 * np.sin(2 * np.pi * fine / 0.04)
    truth = driven(machine, SAMPLE_TIME, speed, 1j * i_q, substeps, theta0=0.8)
    theta, u, i = truth.theta_e[:-1], truth.voltage, truth.current[:-1]
    u = u + (0.10 - 0.06j)  # these offsets make the flux drift
    i = i + (0.08 + 0.05j)
    signals = {"t": np.arange(ROWS) * SAMPLE_TIME, "theta_e": np.mod(theta, 2 * np.pi)}
    signals |= {"u_alpha": u.real, "u_beta": u.imag, "i_alpha": i.real, "i_beta": i.imag}
    for n, phase in enumerate("abc"):
        turn = np.exp(-2j * np.pi / 3 * n)
        signals |= {f"u_{phase}": (u * turn).real, f"i_{phase}": (i * turn).real}
        signals[f"d_{phase}"] = 0.5 + signals[f"u_{phase}"] / 48.0
    signals |= {"u_ab": signals["u_a"] - signals["u_b"], "u_bc": signals["u_b"] - signals["u_c"]}
    middle_angle = (truth.theta_e[:-1] + truth.theta_e[1:]) / 2
    dq, idq = u * np.exp(-1j * middle_angle), i * np.exp(-1j * theta)
    signals |= {"u_d": dq.real, "u_q": dq.imag, "i_d": idq.real, "i_q": idq.imag}
    signals["theta_m"] = np.mod(theta / machine.n_p, 2 * np.pi)
    # A controller logs the voltage one row before it acts, in rotor coordinates of that later time.
    later = np.concatenate([u[1:], u[-1:]])
    later_angle = np.concatenate([middle_angle[1:], middle_angle[-1:]])
    signals |= {"later_alpha": later.real, "later_beta": later.imag}
    signals |= {"later_d": (later * np.exp(-1j * later_angle)).real}
    signals |= {"later_q": (later * np.exp(-1j * later_angle)).imag}
    earlier = np.concatenate(
        [u[:1], u[:-1]]
    )  # the voltage acts over the interval that ends at its row
    signals |= {"before_alpha": earlier.real, "before_beta": earlier.imag}
    for n, phase in enumerate("abc"):
        signals[f"before_{phase}"] = (earlier * np.exp(-2j * np.pi / 3 * n)).real
    return signals


def lines(
    columns: list[Array],
    delimiter: str = ",",
    form: str = "{:.9g}",
    comma: bool = False,
    tail: str = "",
    head: str = "",
) -> list[str]:
    rows = []
    for row in zip(*columns, strict=True):
        cells = delimiter.join(form.format(value) for value in row)
        rows.append(head + (cells.replace(".", ",") if comma else cells) + tail)
    return rows


def text(
    path: Path, rows: list[str], end: str = "\n", encoding: str = "utf-8", last: bool = True
) -> None:
    path.write_bytes((end.join(rows) + (end if last else "")).encode(encoding))


def pick(r: dict[str, Array], names: str) -> list[Array]:
    return [r[name] for name in names.split()]


SCOPE = "i_a i_b u_ab u_bc"


# ---- text ------------------------------------------------------------------------------------


def plain_csv(r: dict[str, Array], path: Path) -> None:
    """The layout of this project's README."""
    names = "t u_alpha u_beta i_alpha i_beta theta_e"
    text(path, [",".join(names.split()), *lines(pick(r, names))])


def german_excel_csv(r: dict[str, Array], path: Path) -> None:
    """Excel in a German locale: semicolons, decimal commas, and units in the names."""
    columns = [1e3 * r["t"], *pick(r, "u_a u_b u_c"), *(1e3 * r[n] for n in ("i_a", "i_b"))]
    columns.append(np.degrees(r["theta_m"]))
    names = "Zeit [ms];Ua [V];Ub [V];Uc [V];Ia [mA];Ib [mA];Geber [Grad]"
    text(path, [names, *lines(columns, ";", comma=True)], "\r\n", "cp1252")


def rigol_ds1000z_csv(r: dict[str, Array], path: Path) -> None:
    """Rigol DS1000Z: start and increment in the row of units, and commas at the ends of data rows.
    scottprahl/RigolWFM, tests/files/wfm/DS1054Z-A.csv."""
    rows = ["X,CH1,CH2,CH3,CH4,Start,Increment,"]
    rows += [f"Sequence,Ampere,Ampere,Volt,Volt,{-0.012:.6e},{SAMPLE_TIME:.6e}"]
    data = lines(pick(r, SCOPE), form="{:.6e}", tail=",")
    text(path, [*rows, *(f"{n},{row}" for n, row in enumerate(data))], "\r\n")


def rigol_ds1000e_csv(r: dict[str, Array], path: Path) -> None:
    """Rigol DS1000E: time in single precision, and commas at the ends of all rows.
    scottprahl/RigolWFM, tests/files/wfm/DS1102E-D.csv."""
    t = (r["t"] - 0.06).astype(np.float32)
    rows = ["X,CH1,CH2,CH3,CH4,", "Second,Ampere,Ampere,Volt,Volt,"]
    text(path, [*rows, *lines([t, *pick(r, SCOPE)], form="{:.7e}", tail=",")], "\r\n")


def rigol_dho_csv(r: dict[str, Array], path: Path) -> None:
    """Rigol MSO5000 and DHO: units in the names, and times in cells of the header.
    Source: the test writer of a parser, rigol_fastrec."""
    head = f"CH1A,CH2A,CH3V,CH4V,t0 ={-0.012:.6e}, tInc = {SAMPLE_TIME:.6e},"
    text(path, [head, *lines(pick(r, SCOPE), form="{:+.6e}", tail=",,")], "\r\n")


def keysight_infiniivision_csv(r: dict[str, Array], path: Path) -> None:
    """Keysight InfiniiVision: numbers instead of names, and engineering exponents.
    w0nder1ng/avr-power-trace, data/scope_0.csv."""

    def engineering(value: float) -> str:
        power = 0 if value == 0 else int(np.floor(np.log10(abs(value)) / 3)) * 3
        return f"{value / 10.0**power:+.6f}E{power:+03d}"

    columns = [r["t"] - 0.06, *pick(r, SCOPE)]
    rows = ["x-axis,1,2,3,4", "second,Ampere,Ampere,Volt,Volt"]
    rows += [",".join(map(engineering, row)) for row in zip(*columns, strict=True)]
    text(path, rows)


def picoscope_csv(r: dict[str, Array], path: Path) -> None:
    """PicoScope 6: units in brackets below the names, then a blank line; ∞ if out of range.
    Manual of PicoScope 6, text formats."""
    rows = ["Time,Channel A,Channel B,Channel C,Channel D", "(ms),(A),(A),(V),(V)", ""]
    data = lines([1e3 * r["t"] - 60, *pick(r, SCOPE)], form="{:.8f}")
    text(path, [*rows, *data], "\r\n")


def picoscope_comma_csv(r: dict[str, Array], path: Path) -> None:
    """PicoScope 6 in a European locale, with microseconds and millivolts, in UTF-8."""
    rows = ["Zeit;Kanal A;Kanal B;Kanal C;Kanal D", "(µs);(mA);(mA);(mV);(mV)", ""]
    scaled = [1e6 * r["t"] - 200.0, *(1e3 * x for x in pick(r, SCOPE))]
    text(path, [*rows, *lines(scaled, ";", "{:.6f}", comma=True)], "\r\n")


def saleae_csv(r: dict[str, Array], path: Path) -> None:
    """Saleae Logic 2: analog export with the user's names. danielp96/WP4-code, analog.csv."""
    rows = ["Time [s],Ia,Ib,Uab,Ubc"]
    text(path, [*rows, *lines([r["t"], *pick(r, SCOPE)], form="{:.9f}")])


def tektronix_mso_csv(r: dict[str, Array], path: Path) -> None:
    """Tektronix MSO/DPO3000: preamble, labels of the user, and rounded time.
    FractionalIntuition/BEE331_Lab_4, tek0000.csv."""
    rows = ["Model,MSO3014", "Firmware Version,2.40", "", "Waveform Type,ANALOG,"]
    rows += ["Point Format,Y,", "Horizontal Units,s,", "Horizontal Scale,0.02,"]
    rows += ["Horizontal Delay,0,", f"Sample Interval,{SAMPLE_TIME:g},", f"Record Length,{ROWS},"]
    rows += ["Gating,0.0% to 100.0%,", "Probe Attenuation,1,", "Vertical Units,A,"]
    rows += ["Vertical Offset,0,", "Vertical Scale,5,", "Vertical Position,0,", ",,", ",,", ",,"]
    rows += ["Label,Ia,Ib,Uab,Ubc", "TIME,CH1,CH2,CH3,CH4"]
    data = lines(pick(r, SCOPE), form="{:.7g}")
    times = [f"{value:.4e}" for value in r["t"] - 0.06]
    text(path, [*rows, *(f"{t},{row}" for t, row in zip(times, data, strict=True)), ""], "\r\n")


def siglent_csv(r: dict[str, Array], path: Path) -> None:
    """Siglent SDS1000X-E: a preamble whose values contain the names of channels.
    evanmoring/siglent_utils, SDS00001.csv."""
    rows = [f"Record Length,Analog:{ROWS}", f"Sample Interval,CH1:{SAMPLE_TIME:.13f}"]
    rows += ["Vertical Units,CH1:A,CH2:A,CH3:V,CH4:V", "Vertical Scale,CH1:5.00,,,"]
    rows += ["Horizontal Units,us,,,", "Horizontal Scale,20000.0000000000,,,"]
    rows += ["Model Number,SDS1204X-E,,,", "Software Version,1.3.26,,,"]
    rows += ["Source,CH1,CH2,CH3,CH4", "Second,Ampere,Ampere,Volt,Volt"]
    data = lines([r["t"], *pick(r, SCOPE)], form="{: .11f}")
    text(path, [*rows, *data])


def rohde_schwarz_csv(r: dict[str, Array], path: Path) -> None:
    """Rohde & Schwarz RTB, RTM: names and units in one row. Manual of the RTM20."""
    rows = ["in s,C1 in A,C2 in A,C3 in V,C4 in V"]
    text(path, [*rows, *lines([r["t"] - 0.06, *pick(r, SCOPE)], form="{:.7E}")], "\r\n")


def yokogawa_csv(r: dict[str, Array], path: Path) -> None:
    """Yokogawa DL and SL: quoted keys, a value below the name of each trace, and no time.
    Manual IM DLM3054-01EN, appendix 3."""
    rows = ['"Header Size",11', '"Model Name","DLM3054"', '"Comment",""', '"BlockNumber",1']
    rows += ['"TraceName","Ia","Ib","Uab","Ubc"', f'"BlockSize",{",".join([str(ROWS)] * 4)}']
    rows += ['"VUnit","A","A","V","V"', f'"SampleRate",{",".join(["5000"] * 4)}']
    rows += [f'"HResolution",{",".join([f"{SAMPLE_TIME:.8E}"] * 4)}']
    rows += ['"HOffset",0,0,0,0', '"HUnit","s","s","s","s"', ""]
    text(path, [*rows, *lines(pick(r, SCOPE), form="{:.7E}", head=",")], "\r\n")


def hioki_txt(r: dict[str, Array], path: Path) -> None:
    """Hioki Memory HiCorder: a row of units, a row of names, each after a key, and then "DATA".
    Manual of the 8841."""
    rows = ['"COMMENT","drive"', '"DATE","01-01-2026"', '"TIME","10:10:00"', '"NUM_SIGS", 5']
    rows += [f'"INTERVAL", {SAMPLE_TIME:.3E}', '"HORZ_UNITS", "S"']
    rows += ['"VERT_UNITS", "S", "A", "A", "V", "V"']
    rows += ['"SIGNAL","TIME", "Ia", "Ib", "Uab", "Ubc"', '"DATA"']
    text(path, [*rows, *lines([r["t"], *pick(r, SCOPE)], ", ", "{:+.6E}")], "\r\n")


def labview_lvm(r: dict[str, Array], path: Path) -> None:
    """LabVIEW measurement file with decimal commas, without a time column.
    ladisk/lvm_read, data/short.lvm."""
    rows = ["LabVIEW Measurement\t", "Writer_Version\t2", "Reader_Version\t2", "Separator\tTab"]
    rows += ["Decimal_Separator\t,", "Multi_Headings\tYes", "X_Columns\tNo"]
    rows += ["Time_Pref\tAbsolute", "Operator\tJS", "Date\t2026/02/19"]
    rows += ["Time\t09:51:39,1970510124996275989", "***End_of_Header***\t", "\t", "Channels\t5\t\t"]
    rows += ["Samples" + f"\t{ROWS}" * 5 + "\t", "Date" + "\t2026/02/19" * 5 + "\t"]
    rows += ["Time" + "\t09:51:40,7271890640258789063" * 5 + "\t"]
    rows += ["Y_Unit_Label\tVolts\tVolts\tVolts\tAmps\tAmps\t", "X_Dimension" + "\tTime" * 5 + "\t"]
    rows += ["X0" + "\t0,0000000000000000E+0" * 5 + "\t", "Delta_X" + "\t2,000000E-4" * 5 + "\t"]
    rows += ["***End_of_Header***" + "\t" * 6, "X_Value\tUa\tUb\tUc\tIa\tIb\tComment"]
    data = lines(pick(r, "u_a u_b u_c i_a i_b"), "\t", "{:.6f}", comma=True, head="\t")
    text(path, [*rows, *data], "\r\n", "cp1252")


def labview_times_lvm(r: dict[str, Array], path: Path) -> None:
    """LabVIEW measurement file with one time column per channel. ladisk/lvm_read,
    multi_time_column."""
    rows = ["LabVIEW Measurement\t", "Writer_Version\t2", "Reader_Version\t2", "Separator\tTab"]
    rows += ["Decimal_Separator\t.", "Multi_Headings\tNo", "X_Columns\tMulti"]
    rows += ["***End_of_Header***\t", "\t", "Channels\t4\t\t\t\t\t\t", f"Samples\t{ROWS}\t\t{ROWS}"]
    rows += ["***End_of_Header***\t\t\t\t\t\t\t\t"]
    rows += ["X_Value\tIa\tX_Value\tIb\tX_Value\tUab\tX_Value\tUbc\tComment"]
    columns = [x for signal in pick(r, SCOPE) for x in (r["t"], signal)]
    text(path, [*rows, *lines(columns, "\t", "{:.6f}")], "\r\n")


def twincat_csv(r: dict[str, Array], path: Path) -> None:
    """Beckhoff TwinCAT Scope: a block of keys for all columns, and time in ms below "Name".
    CagtayFabry/pytcs, tests/data/tc3_scope_3_4_3145_3.csv."""
    names = ["ia", "ib", "ua", "ub", "uc"]
    rows = ["Name\tdrive", "File\tdrive.csv"]
    rows += ["Starttime of export\t132959733843760000\tMontag, 2. Mai 2022\t15:56:24.376"]
    rows += ["Endtime of export\t132959733853750000\tMontag, 2. Mai 2022\t15:56:25.375", "", ""]
    rows += ["\t".join(["Name", *names]), "SymbolComment" + "\t" * 5]
    rows += ["Data-Type" + "\tREAL32" * 5, "SampleTime[ms]" + "\t0,2" * 5]
    rows += ["VariableSize" + "\t4" * 5, "SymbolBased" + "\tTrue" * 5]
    rows += ["Unit\tA\tA\tV\tV\tV", "Unit ScaleFactor" + "\t1" * 5, "Unit Offset" + "\t0" * 5, ""]
    columns = [1e3 * r["t"], *pick(r, "i_a i_b u_a u_b u_c")]
    text(path, [*rows, *lines(columns, "\t", comma=True), "EOF"], "\r\n")


def simulink_inspector_csv(r: dict[str, Array], path: Path) -> None:
    """Simulink Data Inspector: rows of metadata between names and data.
    MathWorks, Data Inspector CSV file format."""
    rows = ["time,u_a,u_b,u_c,i_a,i_b", ",Unit: V,Unit: V,Unit: V,Unit: mA,Unit: mA"]
    rows += [",Interp: zoh,Interp: zoh,Interp: zoh,Interp: linear,Interp: linear"]
    columns = [*pick(r, "t u_a u_b u_c"), 1e3 * r["i_a"], 1e3 * r["i_b"]]
    text(path, [*rows, *lines(columns)])


def twin_builder_csv(r: dict[str, Array], path: Path) -> None:
    """Ansys Twin Builder: quoted names with units. Ansys help, CSV file format."""
    rows = ['"Time [ms]", "U_A.V [V]", "U_B.V [V]", "U_C.V [V]", "I_A.I [A]", "I_B.I [A]"']
    text(path, [*rows, *lines([1e3 * r["t"], *pick(r, "u_a u_b u_c i_a i_b")])])


def plecs_csv(r: dict[str, Array], path: Path) -> None:
    """PLECS scope export with the names of the scope. Plexim documentation, scope."""
    rows = ["Time / s,ia / A,ib / A,ic / A,ua / V,ub / V,uc / V"]
    text(path, [*rows, *lines(pick(r, "t i_a i_b i_c u_a u_b u_c"))])


def pyx2cscope_csv(r: dict[str, Array], path: Path) -> None:
    """Microchip pyX2Cscope: semicolon and blank between cells; the last line is not ended.
    X2Cscope/pyx2cscope, gui/web/views/scope_view.py."""
    rows = ["time (ms); Ialpha; Ibeta; Ualpha; Ubeta"]
    columns = [1e3 * r["t"], *pick(r, "i_alpha i_beta u_alpha u_beta")]
    text(path, [*rows, *lines(columns, "; ")], last=False)


def dewesoft_txt(r: dict[str, Array], path: Path) -> None:
    """Dewesoft X text export: names with units, and tabs between cells."""
    rows = ["Data header", "File name:\tdrive.dxd", "Sample rate:\t5000 Hz", ""]
    rows += ["Time (s)\tUa (V)\tUb (V)\tUc (V)\tIa (A)\tIb (A)\tIc (A)"]
    text(path, [*rows, *lines(pick(r, "t u_a u_b u_c i_a i_b i_c"), "\t")], "\r\n")


def unicode_text_txt(r: dict[str, Array], path: Path) -> None:
    """Excel's "Unicode text": UTF-16 with tabs."""
    rows = ["t [s]\tu_α [V]\tu_β [V]\ti_α [A]\ti_β [A]\tθ [°]"]
    columns = [*pick(r, "t u_alpha u_beta i_alpha i_beta"), np.degrees(r["theta_e"])]
    text(path, [*rows, *lines(columns, "\t")], "\r\n", "utf-16")


def fixed_width_dat(r: dict[str, Array], path: Path) -> None:
    """Columns of fixed width with a % header, as in files of Octave and simulators."""
    rows = ["% simulation of a drive", "%  t           ua        ub        uc       ia       ib"]
    data = lines(pick(r, "t u_a u_b u_c i_a i_b"), "", "{:14.6e}")
    text(path, [*rows, *data])


def data_logger_csv(r: dict[str, Array], path: Path) -> None:
    """A logger with wall-clock stamps and a header repeated above each block."""
    stamps = [f"2026-11-22 12:00:{seconds:09.6f}" for seconds in 59.95 + r["t"]]
    stamps = [
        s if float(s[17:]) < 60 else f"2026-11-22 12:01:{float(s[17:]) - 60:09.6f}" for s in stamps
    ]
    data = lines(pick(r, "u_a u_b u_c i_a i_b"))
    rows = []
    for n, (stamp, row) in enumerate(zip(stamps, data, strict=True)):
        if n % 200 == 0:
            rows.append("Timestamp,Ua [V],Ub [V],Uc [V],Ia [A],Ib [A]")
        rows.append(f"{stamp},{row}")
    text(path, rows)


def inverter_trace_csv(r: dict[str, Array], path: Path) -> None:
    """A drive's trace: duty cycles in percent, DC link, encoder; the last line is cut off."""
    rows = ["sample_us,dutyA [%],dutyB [%],dutyC [%],Vdc [V],Ia [A],Ib [A],encoder [deg]"]
    duties = [100 * x for x in pick(r, "d_a d_b d_c")]
    columns = [1e6 * r["t"], *duties, np.full(ROWS, 48.0), *pick(r, "i_a i_b")]
    data = lines([*columns, np.degrees(r["theta_m"])])
    rows[0] = rows[0].replace("sample_us", "time_us")
    text(path, [*rows, *data, "120000,51.2,49"], last=False)


def controller_trace_csv(r: dict[str, Array], path: Path) -> None:
    """A field-oriented controller's trace: dq, angle in degrees, time in milliseconds."""
    rows = ["time [ms];id [A];iq [A];ud [V];uq [V];theta_el [deg]"]
    columns = [1e3 * r["t"], *pick(r, "i_d i_q u_d u_q"), np.degrees(r["theta_e"])]
    text(path, [*rows, *lines(columns, ";")])


# ---- firmware tools, with presets ------------------------------------------------------------


def vesc_sampled_csv(r: dict[str, Array], path: Path) -> None:
    """Sampled data of VESC Tool. vedderb/vesc_tool, pages/pagesampleddata.cpp."""
    rows = ["T;I1;I2;I3;V1;V2;V3;I_tot;V_zero;Phase"]
    phase = np.round(np.degrees(r["theta_e"]) / 1.44) * 1.44
    columns = [*pick(r, "t i_a i_b i_c u_a u_b u_c"), np.hypot(r["i_alpha"], r["i_beta"])]
    columns += [np.full(ROWS, 24.0), phase]
    text(path, [*rows, *lines(columns, ";", "{:.6g}", tail=";")], last=False)


def mesc_csv(r: dict[str, Array], path: Path) -> None:
    """MESC's fast-loop log as columns: the command acts one period later."""
    angle = np.round(r["theta_e"] / (2 * np.pi) * 65536) % 65536
    names = "time,Vd,Vq,Iu,Iv,Iw,angle"
    columns = [*pick(r, "t later_d later_q i_a i_b i_c"), angle]
    text(path, [names, *lines(columns)])


def moteus_npz(r: dict[str, Array], path: Path) -> None:
    """Decoded debug stream of moteus, at a rate other than the usual 30 kHz."""
    names = {"servo_control.d_V": "later_d", "servo_control.q_V": "later_q"}
    names |= {"servo_stats.d_A": "i_d", "servo_stats.q_A": "i_q"}
    names |= {"servo_stats.electrical_theta": "theta_e"}
    np.savez(path, **{name: r[signal] for name, signal in names.items()})


def odrive_csv(r: dict[str, Array], path: Path) -> None:
    """Properties of ODrive that were captured together."""
    prefix = "axis0.motor.current_control."
    names = ["final_v_alpha", "final_v_beta", "Ialpha_measured", "Ibeta_measured"]
    rows = [",".join(["time", *(prefix + name for name in names)])]
    text(path, [*rows, *lines(pick(r, "t later_alpha later_beta i_alpha i_beta"))])


def motulator_npz(r: dict[str, Array], path: Path) -> None:
    """Discrete results of motulator, saved as its preset describes."""
    names = {"u_alpha": "before_alpha", "u_beta": "before_beta", "i_alpha": "i_alpha"}
    names |= {"i_beta": "i_beta", "t": "t", "theta_m": "theta_e"}
    np.savez(path, **{name: r[signal] for name, signal in names.items()})


def gym_electric_motor_csv(r: dict[str, Array], path: Path) -> None:
    """States of gym-electric-motor, multiplied by their limits, with a time column."""
    names = "t,omega,torque,i_a,i_b,i_c,u_a,u_b,u_c,epsilon"
    epsilon = np.angle(np.exp(1j * r["theta_e"]))
    columns = [r["t"], np.full(ROWS, 100.0), np.zeros(ROWS), *pick(r, "i_a i_b i_c")]
    columns += [*pick(r, "before_a before_b before_c"), epsilon]
    text(path, [names, *lines(columns)])


# ---- binary ----------------------------------------------------------------------------------


def csv_gz(r: dict[str, Array], path: Path) -> None:
    """The README's CSV, compressed."""
    names = "t u_alpha u_beta i_alpha i_beta"
    rows = "\n".join([",".join(names.split()), *lines(pick(r, names))]) + "\n"
    path.write_bytes(gzip.compress(rows.encode(), mtime=0))


def npy(r: dict[str, Array], path: Path) -> None:
    """A structured NumPy array."""
    names = ["t", "u_a", "u_b", "u_c", "i_a", "i_b"]
    array = np.zeros(ROWS, dtype=[(name, "f8") for name in names])
    for name in names:
        array[name] = r[name]
    np.save(path, array)


def parquet(r: dict[str, Array], path: Path) -> None:
    """Parquet with time stamps in nanoseconds, as pandas writes a DatetimeIndex."""
    stamps = np.round(1e9 * r["t"]).astype("int64") + 1_795_000_000_000_000_000
    frame = pl.DataFrame({"time": pl.Series(stamps).cast(pl.Datetime("ns"))})
    names = {"Ua": "u_a", "Ub": "u_b", "Uc": "u_c", "Ia": "i_a", "Ib": "i_b"}
    frame.with_columns(
        **{name: pl.Series(r[signal]) for name, signal in names.items()}
    ).write_parquet(path)


def feather(r: dict[str, Array], path: Path) -> None:
    """Arrow file of single-precision columns."""
    names = "t u_a u_b u_c i_a i_b"
    frame = pl.DataFrame({name: r[name] for name in names.split()})
    frame.with_columns(pl.exclude("t").cast(pl.Float32)).write_ipc(path)


def matlab_mat(r: dict[str, Array], path: Path) -> None:
    """MATLAB version 5 with a struct of column vectors."""
    from scipy.io import savemat

    names = "t u_alpha u_beta i_alpha i_beta theta_e"
    savemat(path, {"log": {n: r[n][:, None] for n in names.split()}, "Ts": SAMPLE_TIME})


def simulink_mat(r: dict[str, Array], path: Path) -> None:
    """Simulink "structure with time": time and labelled signals."""
    from scipy.io import savemat

    signals = np.array(
        [{"values": r[n][:, None], "label": n} for n in ("u_a", "u_b", "u_c", "i_a", "i_b")]
    )
    savemat(path, {"ScopeData": {"time": r["t"][:, None], "signals": signals}})


def dspace_mat(r: dict[str, Array], path: Path) -> None:
    """dSPACE ControlDesk: X with the time, Y with name, unit and data of each signal."""
    from scipy.io import savemat

    names = {"u_alpha": "V", "u_beta": "V", "i_alpha": "A", "i_beta": "A"}
    y = np.array([{"Name": n, "Data": r[n], "Unit": u, "XIndex": 1} for n, u in names.items()])
    savemat(path, {"drive": {"X": {"Name": "Time", "Data": r["t"], "Unit": "s"}, "Y": y}})


def matlab_v73_mat(r: dict[str, Array], path: Path) -> None:
    """MATLAB version 7.3: HDF5 after the first 512 bytes; vectors have shape (1, N)."""
    import h5py

    with h5py.File(path, "w", userblock_size=512) as file:
        for name in ["t", "u_alpha", "u_beta", "i_alpha", "i_beta"]:
            file.create_dataset(f"log/{name}", data=r[name][None, :])
    with path.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: Sun Nov 22 12:00:00 2026")
        raw.seek(124)
        raw.write(b"\x00\x02IM")


def hdf5_h5(r: dict[str, Array], path: Path) -> None:
    """HDF5 with groups of different rates: the voltages have twice the rate of the currents."""
    import h5py

    with h5py.File(path, "w") as file:
        for name in ("i_a", "i_b"):
            file[f"adc/{name}"] = r[name]
            file[f"adc/{name}"].attrs["unit"] = "A"
        file["adc/time"] = r["t"]
        file["adc/time"].attrs["unit"] = "s"
        for name in ("u_a", "u_b", "u_c"):
            file[f"pwm/{name}"] = np.repeat(r[name], 2)
            file[f"pwm/{name}"].attrs["unit"] = "V"
        file["pwm/time"] = np.arange(2 * ROWS) * SAMPLE_TIME / 2
        file["pwm/time"].attrs["unit"] = "s"


def mdf_mf4(r: dict[str, Array], path: Path) -> None:
    """MDF4 with two channel groups of the same rate."""
    from asammdf import MDF, Signal

    mdf = MDF(version="4.10")
    for group, names, unit in (("currents", "i_a i_b i_c", "A"), ("voltages", "u_a u_b u_c", "V")):
        signals = [Signal(r[n], r["t"], name=n, unit=unit) for n in names.split()]
        mdf.append(signals, acq_name=group)
    mdf.save(path, overwrite=True, compression=2)
    mdf.close()


def labview_tdms(r: dict[str, Array], path: Path) -> None:
    """TDMS with waveform properties instead of a time channel, and with units as properties."""
    from nptdms import ChannelObject, TdmsWriter

    units = {"Ua": ("u_a", "V"), "Ub": ("u_b", "V"), "Uc": ("u_c", "V")}
    units |= {"Ia": ("i_a", "A"), "Ib": ("i_b", "A")}
    with TdmsWriter(path) as writer:
        for name, (signal, unit) in units.items():
            properties = {"unit_string": unit, "wf_increment": SAMPLE_TIME, "wf_start_offset": 0.0}
            writer.write_segment([ChannelObject("Drive", name, r[signal], properties)])


def px4_ulg(r: dict[str, Array], path: Path) -> None:
    """ULog with a custom topic. PX4 documentation, ULog file format."""

    def message(kind: bytes, body: bytes) -> bytes:
        return struct.pack("<HB", len(body), kind[0]) + body

    names = ["u_alpha", "u_beta", "i_alpha", "i_beta"]
    fields = ";".join(["uint64_t timestamp", *(f"float {name}" for name in names)])
    content = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0) + message(b"B", bytes(40))
    content += message(b"F", f"motor_foc:{fields};".encode())
    content += message(b"A", struct.pack("<BH", 0, 0) + b"motor_foc")
    for k in range(ROWS):
        row = struct.pack("<HQ4f", 0, 1000 + round(1e6 * r["t"][k]), *(r[n][k] for n in names))
        content += message(b"D", row)
    path.write_bytes(content)


def workbook_xlsx(r: dict[str, Array], path: Path) -> None:
    """Excel with a title, names and a row of units."""
    import xlsxwriter

    with xlsxwriter.Workbook(path) as book:
        sheet = book.add_worksheet("Test 7")
        sheet.write(0, 0, "Servo, test 7")
        for n, (name, unit) in enumerate(
            zip(
                ("Time", "Ua", "Ub", "Uc", "Ia", "Ib"), ("ms", "V", "V", "V", "A", "A"), strict=True
            )
        ):
            sheet.write(2, n, name)
            sheet.write(3, n, unit)
        for n, values in enumerate([1e3 * r["t"], *pick(r, "u_a u_b u_c i_a i_b")]):
            sheet.write_column(4, n, values)


def workbook_xls(r: dict[str, Array], path: Path) -> None:
    """An Excel 97 workbook without title and units."""
    sys.path.append(str(Path(__file__).parents[1]))
    from support.biff import old_workbook

    names = ["t", "u_a", "u_b", "u_c", "i_a", "i_b"]
    heads = [(0, n, name) for n, name in enumerate(names)]
    rows = [(k + 1, n, float(r[name][k])) for k in range(ROWS) for n, name in enumerate(names)]
    path.write_bytes(old_workbook(1, [*heads, *rows]))


def npz(r: dict[str, Array], path: Path) -> None:
    """NumPy archive with three phases."""
    np.savez(path, **{n: r[n] for n in ["t", "u_a", "u_b", "u_c", "i_a", "i_b", "i_c"]})


#: Layouts whose function names do not end with the ending of the file.
_ENDINGS = {"csv_gz": "log.csv.gz"}

LAYOUTS: dict[str, Callable[[dict[str, Array], Path], None]] = {}
for _layout in (
    *(plain_csv, german_excel_csv, rigol_ds1000z_csv, rigol_ds1000e_csv, rigol_dho_csv),
    *(keysight_infiniivision_csv, picoscope_csv, picoscope_comma_csv, saleae_csv),
    *(tektronix_mso_csv, siglent_csv, rohde_schwarz_csv, yokogawa_csv, hioki_txt, labview_lvm),
    *(labview_times_lvm, twincat_csv, simulink_inspector_csv, twin_builder_csv, plecs_csv),
    *(pyx2cscope_csv, dewesoft_txt, unicode_text_txt, fixed_width_dat, data_logger_csv),
    *(inverter_trace_csv, controller_trace_csv, vesc_sampled_csv, mesc_csv, moteus_npz),
    *(odrive_csv, motulator_npz, gym_electric_motor_csv, csv_gz, npy, parquet, feather),
    *(matlab_mat, simulink_mat, dspace_mat, matlab_v73_mat, hdf5_h5, mdf_mf4, labview_tdms),
    *(px4_ulg, workbook_xlsx, workbook_xls, npz),
):
    _name = _layout.__name__
    _stem, _, _ending = _name.rpartition("_")
    _file = _ENDINGS.get(_name) or (f"{_stem}.{_ending}" if _stem else f"log.{_name}")
    LAYOUTS[_file.replace("_", "-")] = _layout
#: Files that need a preset.
PRESETS = {
    "moteus.npz": "moteus",
    "vesc-sampled.csv": "vesc-sampled",
    "mesc.csv": "mesc",
    "odrive.csv": "odrive",
    "motulator.npz": "motulator",
    "gym-electric-motor.csv": "gym-electric-motor",
}


def main() -> None:
    FOLDER.mkdir(exist_ok=True)
    signals = run()
    for name, layout in LAYOUTS.items():
        layout(signals, FOLDER / name)
    size = sum(path.stat().st_size for path in FOLDER.iterdir())
    print(f"{len(LAYOUTS)} files, {size / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
