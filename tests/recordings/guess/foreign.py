"""Twenty files with other people's names: test benches, ECUs, loggers, apps, J1939; German, abbreviated, without units.

Each is the same simulated drive. A channel is written as "name [unit]: quantity", the conversion follows from the unit;
what is not one of our quantities is there to lead astray.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pandas as pd

from dieseltwin.recordings.importers.layout import unit_in_name

CYLINDERS, DENSITY, AMBIENT = 6, 0.835, 97_000.0
Values = np.ndarray

# unit -> from SI
TO: dict[str, Callable[[Values], Values]] = {
    "": lambda x: x, "Pa": lambda x: x, "hPa": lambda x: x / 1e2, "mbar": lambda x: x / 1e2, "kPa": lambda x: x / 1e3,
    "bar": lambda x: x / 1e5, "psi": lambda x: x / 6894.757, "K": lambda x: x, "degC": lambda x: x - 273.15,
    "degF": lambda x: (x - 273.15) * 1.8 + 32.0, "kg/s": lambda x: x, "kg/h": lambda x: x * 3600.0,
    "g/s": lambda x: x * 1e3,
    "lb/min": lambda x: x * 60.0 / 0.45359237, "L/h": lambda x: x * 3600.0 / DENSITY, "rad/s": lambda x: x,
    "rpm of rad/s": lambda x: x * 30.0 / np.pi, "krpm of rad/s": lambda x: x * 0.03 / np.pi,
    "1/s of rpm": lambda x: x / 60.0,
    "%": lambda x: x, "fraction": lambda x: x / 100.0, "% shut": lambda x: 100.0 - x,
    "kPa gauge": lambda x: (x - AMBIENT) / 1e3,
    "mbar gauge": lambda x: (x - AMBIENT) / 1e2, "bar gauge": lambda x: (x - AMBIENT) / 1e5,
    "psi gauge": lambda x: (x - AMBIENT) / 6894.757, "mg": lambda x: x, "MPa": lambda x: x / 1e6,
    "kg/cm2 gauge": lambda x: (x - AMBIENT) / 98066.5, "gal/h": lambda x: x * 3600.0 / DENSITY / 3.785411784,
}  # fmt: skip


@dataclass(frozen=True)
class Foreign:
    """One file: names as written there -> (our quantity or a lure, conversion), and how units are shown."""

    title: str
    channels: dict[str, tuple[str, str]]
    units: dict[str, str]  # name -> text of a row of units; {} for none (units may be in the names)


def drive(reference: pd.DataFrame) -> dict[str, Values]:
    """The quantities in SI, and lures, from the reference trace."""
    n_e, fuel = reference["n_e_rpm"].to_numpy(), reference["u_delta_mg"].to_numpy()
    size = len(reference)
    wander = np.sin(np.arange(size) / 200.0)
    w_f = 1e-6 * fuel * n_e * CYLINDERS / 120.0
    known = {name: reference[name].to_numpy() for name in (
        "time_s", "n_e_rpm", "u_delta_mg", "u_egr_pct", "u_vgt_pct", "p_im_pa", "p_em_pa", "omega_t_rad_s",
        "w_egr_kg_s", "t_em_k", "w_c_kg_s")}  # fmt: skip
    w_c, w_egr = known["w_c_kg_s"], np.maximum(known["w_egr_kg_s"], 0.0)
    return known | {
        "p_amb_pa": np.full(size, AMBIENT), "t_amb_k": 294.0 + 0.5 * wander, "t_im_k": 312.0 + 6.0 * wander,
        "torque_nm": 9.0 * fuel - 150.0, "fuel": w_f, "egr rate": w_egr / (w_egr + w_c),
        "air per stroke": 1e6 * w_c * 120.0 / (n_e * CYLINDERS), "mm3": fuel / DENSITY,
        # lures
        "boost wanted": np.round(known["p_im_pa"] * 1.02, -3), "coolant": 358.0 + 3.0 * wander,
        "oil": 370.0 + 4.0 * wander, "t after": known["t_em_k"] - 90.0, "p after": AMBIENT + 4e3 * (w_c / 0.3) ** 2,
        "rail": 8e7 + 4e5 * fuel, "vehicle": 60.0 + 20.0 * wander, "lambda": w_c / np.maximum(w_f * 14.5, 1e-5),
        "pedal": np.clip(fuel / 2.5, 0, 100), "t compressor": 300.0 + 1e-4 * known["omega_t_rad_s"],
        "idle": np.full(size, 600.0), "egr wanted": np.round(known["u_egr_pct"]), "gear": np.round(3.0 + wander),
        "vgt wanted": np.round(known["u_vgt_pct"]), "air wanted": np.round(w_c * 1.05, 2),
        "air wanted per stroke": np.round(1.05e6 * w_c * 120.0 / (n_e * CYLINDERS), -1), "shaft": 0.97 * n_e,
        "oil pressure": 1.5e5 + 150.0 * n_e, "t fuel": 318.0 + 2.0 * wander, "torque wanted": 9.3 * fuel - 140.0,
        "torque %": fuel / 2.5, "t cooler": 350.0 + 10.0 * wander,
        "p compressor": known["p_im_pa"] + 4e3 * (w_c / 0.3) ** 2, "p inlet": AMBIENT - 2.5e3 * (w_c / 0.3) ** 2,
        "p crankcase": AMBIENT + 300.0 + 0.1 * n_e, "egr dp": known["p_em_pa"] - known["p_im_pa"],
        "filter dp": 2.5e3 * (w_c / 0.3) ** 2, "t inlet": 297.0 + 0.8 * wander, "t egr": 390.0 + 20.0 * wander,
        "t cylinder": known["t_em_k"] - 40.0, "fuel wanted": np.round(1.03 * fuel, 0), "fuel limit": 1.2 * fuel + 20.0,
        "afr": w_c / np.maximum(w_f, 1e-5), "error": np.round(5.0 * wander),
    }  # fmt: skip


def file_of(title: str, text: str, row: bool = False) -> Foreign:
    """Lines 'name | unit as written | quantity | conversion'; `row` writes the units into a row of their own."""
    channels, units = {}, {}
    for line in (line for line in text.strip().split("\n") if line.strip()):
        name, unit, quantity, conversion = (part.strip() for part in line.split("|"))
        channels[name] = (quantity, conversion)
        if row:
            units[name] = unit
    return Foreign(title, channels, units)


FILES: tuple[Foreign, ...] = (
    file_of("ECU labels as INCA shows them", """
        time | s | time_s |
        Epm_nEng | rpm | n_e_rpm |
        InjCtl_qSetUnBal | mg/hub | u_delta_mg |
        EGRVlv_rAct | % | u_egr_pct | %
        EGRVlv_rDes | % | egr wanted | %
        TrbChVGT_rAct | % | u_vgt_pct | %
        PCR_pActVal | hPa | p_im_pa | hPa
        PCR_pDesVal | hPa | boost wanted | hPa
        Exh_pTrbnUs | hPa | p_em_pa | hPa
        TrbChSpd_n | rpm | omega_t_rad_s | rpm of rad/s
        EGR_dmAct | kg/h | w_egr_kg_s | kg/h
        Exh_tTrbnUs | deg C | t_em_k | degC
        Exh_tTrbnDs | deg C | t after | degC
        AFS_dm | kg/h | w_c_kg_s | kg/h
        EnvP_p | hPa | p_amb_pa | hPa
        EnvT_t | deg C | t_amb_k | degC
        CEngDsT_t | deg C | coolant | degC
        RailP_pFlt | hPa | rail | hPa""", row=True),
    file_of("a German test bench", """
        Zeit | s | time_s |
        Drehzahl | 1/min | n_e_rpm |
        Drehmoment | Nm | torque_nm |
        Einspritzmenge | mg/Hub | u_delta_mg |
        AGR-Ventilstellung | % | u_egr_pct | %
        VTG-Stellung | % | u_vgt_pct | %
        Ladedruck | mbar | p_im_pa | mbar
        Ladedruck Soll | mbar | boost wanted | mbar
        Abgasdruck vor Turbine | mbar | p_em_pa | mbar
        Abgasdruck nach Turbine | mbar | p after | mbar
        Turboladerdrehzahl | 1/min | omega_t_rad_s | rpm of rad/s
        AGR-Massenstrom | kg/h | w_egr_kg_s | kg/h
        Abgastemperatur vor Turbine | °C | t_em_k | degC
        Abgastemperatur nach Turbine | °C | t after | degC
        Luftmassenstrom | kg/h | w_c_kg_s | kg/h
        Ladelufttemperatur | °C | t_im_k | degC
        Umgebungsdruck | mbar | p_amb_pa | mbar
        Umgebungstemperatur | °C | t_amb_k | degC
        Kühlwassertemperatur | °C | coolant | degC
        Öltemperatur | °C | oil | degC""", row=True),
    file_of("codes of a test bench", """
        TIME | s | time_s |
        N_DYNO | 1/min | n_e_rpm |
        MD | Nm | torque_nm |
        FB_KST | kg/h | fuel | kg/h
        AGR_POS | % | u_egr_pct | %
        VTG_POS | % | u_vgt_pct | %
        P_22 | bar | p_im_pa | bar
        P_31 | bar | p_em_pa | bar
        P_41 | bar | p after | bar
        N_ATL | 1/min | omega_t_rad_s | rpm of rad/s
        M_AGR | kg/h | w_egr_kg_s | kg/h
        T_31 | °C | t_em_k | degC
        T_41 | °C | t after | degC
        T_22 | °C | t_im_k | degC
        T_21 | °C | t compressor | degC
        M_LUFT | kg/h | w_c_kg_s | kg/h
        P_UMG | mbar | p_amb_pa | mbar
        T_UMG | °C | t_amb_k | degC
        T_OEL | °C | oil | degC""", row=True),
    file_of("a German workshop tester", """
        Zeitstempel | s | time_s |
        Motordrehzahl | /min | n_e_rpm |
        Einspritzmenge | mg/Hub | u_delta_mg |
        AGR-Ventil Position (Ist) | % | u_egr_pct | %
        Ladersteller Position (Ist) | % | u_vgt_pct | %
        Ladedruck (Ist) | mbar | p_im_pa | mbar
        Ladedruck (Soll) | mbar | boost wanted | mbar
        Luftmasse (Ist) | mg/Hub | air per stroke | mg
        Abgastemperatur vor Turbolader | °C | t_em_k | degC
        Abgastemperatur nach Partikelfilter | °C | t after | degC
        Atmosphärendruck | mbar | p_amb_pa | mbar
        Geschwindigkeit | km/h | vehicle |
        Kühlmitteltemperatur | °C | coolant | degC""", row=True),
    file_of("an OBD app on a phone", """
        Device Time | | time_s |
        Engine RPM(rpm) | | n_e_rpm |
        Fuel flow rate/hour(l/hr) | | fuel | L/h
        EGR Commanded(%) | | u_egr_pct | %
        EGR Error(%) | | torque % | %
        Intake Manifold Pressure(kpa) | | p_im_pa | kPa
        Mass Air Flow Rate(g/s) | | w_c_kg_s | g/s
        Exhaust Gas Temperature 1(°C) | | t_em_k | degC
        Engine Coolant Temperature(°C) | | coolant | degC
        Barometric pressure (from vehicle)(kpa) | | p_amb_pa | kPa
        Ambient air temp(°C) | | t_amb_k | degC
        Speed (OBD)(km/h) | | vehicle |"""),
    file_of("J1939 by number", """
        t | | time_s |
        SPN190 | | n_e_rpm |
        SPN183 | | fuel | L/h
        SPN27 | | u_egr_pct | %
        SPN641 | | u_vgt_pct | %
        SPN102 | | p_im_pa | kPa gauge
        SPN1209 | | p_em_pa | kPa gauge
        SPN103 | | omega_t_rad_s | rpm of rad/s
        SPN2659 | | w_egr_kg_s | kg/h
        SPN173 | | t_em_k | degC
        SPN132 | | w_c_kg_s | kg/h
        SPN105 | | t_im_k | degC
        SPN108 | | p_amb_pa | kPa
        SPN171 | | t_amb_k | degC
        SPN110 | | coolant | degC
        SPN84 | | vehicle |"""),
    file_of("J1939 by a DBC", """
        timestamps | s | time_s |
        EngSpeed | rpm | n_e_rpm |
        EngFuelRate | l/h | fuel | L/h
        EngExhaustGasRecirculation1ValvePosition | % | u_egr_pct | %
        EngVariableGeometryTurboActuator1 | % | u_vgt_pct | %
        EngIntakeManifold1AbsolutePress | kPa | p_im_pa | kPa
        EngExhaustPress1 | kPa | p_em_pa | kPa
        EngTurbo1Speed | rpm | omega_t_rad_s | rpm of rad/s
        EngExhaustGasRecirculation1MassFlowRate | kg/h | w_egr_kg_s | kg/h
        EngTurbo1TurbineIntakeTemp | deg C | t_em_k | degC
        EngTurbo1TurbineOutletTemp | deg C | t after | degC
        EngIntakeAirMassFlowRate | kg/h | w_c_kg_s | kg/h
        EngIntakeManifold1Temp | deg C | t_im_k | degC
        EngTurbo1CompressorIntakeTemp | deg C | t compressor | degC
        BarometricPress | kPa | p_amb_pa | kPa
        AmbientAirTemp | deg C | t_amb_k | degC
        EngCoolantTemp | deg C | coolant | degC
        ActualEngPercentTorque | % | torque % | %
        EngInjectorMeteringRail1Press | MPa | rail | Pa
        WheelBasedVehicleSpeed | km/h | vehicle | """, row=True),
    file_of("a Simulink log in SI without units", """
        tout | | time_s |
        n_e | | n_e_rpm |
        u_delta | | u_delta_mg |
        u_egr | | u_egr_pct | %
        u_vgt | | u_vgt_pct | %
        p_im | | p_im_pa | Pa
        p_em | | p_em_pa | Pa
        omega_t | | omega_t_rad_s | rad/s
        W_egr | | w_egr_kg_s | kg/s
        T_em | | t_em_k | K
        W_c | | w_c_kg_s | kg/s"""),
    file_of("camel case without units", """
        time | | time_s |
        engSpd | | n_e_rpm |
        fuelQty | | u_delta_mg |
        egrPos | | u_egr_pct | %
        vgtPos | | u_vgt_pct | %
        pBoost | | p_im_pa | kPa
        pBoostDes | | boost wanted | kPa
        pExh | | p_em_pa | kPa
        nTurbo | | omega_t_rad_s | rpm of rad/s
        egrFlow | | w_egr_kg_s | kg/h
        tExh | | t_em_k | degC
        airFlow | | w_c_kg_s | kg/h
        tCoolant | | coolant | degC
        pAmb | | p_amb_pa | kPa"""),
    file_of("LabVIEW, units in brackets", """
        Time (s) | | time_s |
        Engine Speed (rpm) | | n_e_rpm |
        Injected Fuel (mg/stroke) | | u_delta_mg |
        EGR Valve (%) | | u_egr_pct | %
        VGT Position (%) | | u_vgt_pct | %
        Boost Pressure (bar) | | p_im_pa | bar
        Exhaust Manifold Pressure (bar) | | p_em_pa | bar
        Turbo Speed (krpm) | | omega_t_rad_s | krpm of rad/s
        EGR Flow (g/s) | | w_egr_kg_s | g/s
        Exhaust Temp Pre-Turbine (C) | | t_em_k | degC
        Exhaust Temp Post-Turbine (C) | | t after | degC
        Air Flow (g/s) | | w_c_kg_s | g/s
        Charge Air Temp (C) | | t_im_k | degC
        Ambient Pressure (bar) | | p_amb_pa | bar
        Oil Temp (C) | | oil | degC"""),
    file_of("a service tool, VGT in percent closed", """
        Elapsed Time (s) | | time_s |
        Engine Speed (RPM) | | n_e_rpm |
        Fuel Rate (L/h) | | fuel | L/h
        EGR Valve Position Measured (percent) | | u_egr_pct | %
        Turbocharger Actuator Position Measured (percent) | | u_vgt_pct | % shut
        Intake Manifold Pressure Gauge (kPa) | | p_im_pa | kPa gauge
        Exhaust Gas Pressure (kPa) | | p_em_pa | kPa gauge
        Turbocharger Speed (RPM) | | omega_t_rad_s | rpm of rad/s
        EGR Flow (kg/h) | | w_egr_kg_s | kg/h
        Exhaust Gas Temperature (degC) | | t_em_k | degC
        Intake Air Mass Flow (kg/h) | | w_c_kg_s | kg/h
        Intake Manifold Temperature (degC) | | t_im_k | degC
        Barometric Air Pressure (kPa) | | p_amb_pa | kPa
        Coolant Temperature (degC) | | coolant | degC
        Percent Torque (percent) | | torque % | %"""),
    file_of("German abbreviations without units", """
        t | | time_s |
        nMot | | n_e_rpm |
        mKrHub | | u_delta_mg |
        AGR_Stellung | | u_egr_pct | %
        VTG_Stellung | | u_vgt_pct | %
        pLade | | p_im_pa | mbar
        pLadeSoll | | boost wanted | mbar
        pAbgas | | p_em_pa | mbar
        nATL | | omega_t_rad_s | rpm of rad/s
        mAGR | | w_egr_kg_s | kg/h
        tAbgas | | t_em_k | degC
        mLuft | | w_c_kg_s | kg/h
        pUmg | | p_amb_pa | mbar
        tUmg | | t_amb_k | degC
        tWasser | | coolant | degC"""),
    file_of("English abbreviations without units", """
        TIME | | time_s |
        RPM | | n_e_rpm |
        FUEL_MG | | u_delta_mg |
        EGR_POS | | u_egr_pct | %
        VGT | | u_vgt_pct | %
        MAP | | p_im_pa | kPa
        EXH_PRESS | | p_em_pa | kPa
        NTC | | omega_t_rad_s | rpm of rad/s
        EGR_FLOW | | w_egr_kg_s | g/s
        EGT | | t_em_k | degC
        MAF | | w_c_kg_s | g/s
        BARO | | p_amb_pa | kPa
        ECT | | coolant | degC
        TPS | | pedal | %"""),
    file_of("American units, gauge", """
        Time [sec] | | time_s |
        Engine Speed [RPM] | | n_e_rpm |
        Fuel Quantity [mg/stroke] | | u_delta_mg |
        EGR Position [%] | | u_egr_pct | %
        VGT Vane Position [%] | | u_vgt_pct | %
        Boost [psig] | | p_im_pa | psi gauge
        Exhaust Manifold Pressure [psig] | | p_em_pa | psi gauge
        Turbo Shaft Speed [rpm] | | omega_t_rad_s | rpm of rad/s
        EGT Pre-Turbo [°F] | | t_em_k | degF
        EGR Mass Flow [lb/min] | | w_egr_kg_s | lb/min
        Air Mass Flow [lb/min] | | w_c_kg_s | lb/min
        Barometer [psi] | | p_amb_pa | psi
        Ambient Temp [°F] | | t_amb_k | degF
        Coolant Temp [°F] | | coolant | degF"""),
    file_of("capitals of an automation system", """
        TIME | s | time_s |
        SPEED | rpm | n_e_rpm |
        TORQUE | Nm | torque_nm |
        FUEL_MASS_FLOW | kg/h | fuel | kg/h
        EGR_VALVE_POS | % | u_egr_pct | %
        VGT_POS | % | u_vgt_pct | %
        P_INT_MAN | kPa | p_im_pa | kPa
        P_EXH_MAN | kPa | p_em_pa | kPa
        TURBO_SPEED | rpm | omega_t_rad_s | rpm of rad/s
        EGR_MASS_FLOW | kg/h | w_egr_kg_s | kg/h
        T_EXH_MAN | degC | t_em_k | degC
        T_INT_MAN | degC | t_im_k | degC
        AIR_MASS_FLOW | kg/h | w_c_kg_s | kg/h
        P_BARO | kPa | p_amb_pa | kPa
        T_CELL | degC | t_amb_k | degC
        T_COOLANT_OUT | degC | coolant | degC
        P_RAIL | MPa | rail | Pa""", row=True),
    file_of("names of a measurement configuration", """
        time | s | time_s |
        nEngine | 1/min | n_e_rpm |
        qInjTotal | mg/cyc | u_delta_mg |
        rEGRValve | % | u_egr_pct | %
        rVGTPos | % | u_vgt_pct | %
        pIntakeManifold | hPa | p_im_pa | hPa
        pIntakeManifoldSetpoint | hPa | boost wanted | hPa
        pExhaustManifold | hPa | p_em_pa | hPa
        nTurbocharger | 1/min | omega_t_rad_s | rpm of rad/s
        mdotEGR | kg/h | w_egr_kg_s | kg/h
        TExhaustManifold | degC | t_em_k | degC
        mdotAir | kg/h | w_c_kg_s | kg/h
        pAmbient | hPa | p_amb_pa | hPa
        TAmbient | degC | t_amb_k | degC
        TCoolant | degC | coolant | degC
        lambdaExhaust | - | lambda | """, row=True),
    file_of("German, flows as shares and per stroke", """
        Zeit [s] | | time_s |
        Motordrehzahl [1/min] | | n_e_rpm |
        Kraftstoffverbrauch [kg/h] | | fuel | kg/h
        AGR-Ventilhub [%] | | u_egr_pct | %
        Leitschaufelstellung [%] | | u_vgt_pct | %
        Ladedruck relativ [bar] | | p_im_pa | bar gauge
        Abgasgegendruck vor ATL [bar] | | p_em_pa | bar gauge
        ATL-Drehzahl [1/min] | | omega_t_rad_s | rpm of rad/s
        AGR-Rate [%] | | egr rate | fraction of 1
        Abgastemperatur vor ATL [°C] | | t_em_k | degC
        Luftmasse [mg/Hub] | | air per stroke | mg
        Luftdruck [hPa] | | p_amb_pa | hPa
        Außentemperatur [°C] | | t_amb_k | degC
        Öltemperatur [°C] | | oil | degC"""),
    file_of("fractions and revolutions per second", """
        t_s | | time_s |
        n_engine_1/s | | n_e_rpm | 1/s of rpm
        m_fuel_inj [mg/cycle] | | u_delta_mg |
        egr_valve_opening | | u_egr_pct | fraction
        vgt_opening | | u_vgt_pct | fraction
        p_intake [bar] | | p_im_pa | bar
        p_exhaust [bar] | | p_em_pa | bar
        n_turbo [1/min] | | omega_t_rad_s | rpm of rad/s
        m_dot_egr [g/s] | | w_egr_kg_s | g/s
        T_exhaust [K] | | t_em_k | K
        m_dot_air [g/s] | | w_c_kg_s | g/s
        T_intake [K] | | t_im_k | K
        p_ambient [bar] | | p_amb_pa | bar"""),
    file_of("a generating set", """
        Timestamp | ms | time_s |
        Eng. speed | rpm | n_e_rpm |
        Fuel cons. | g/s | fuel | g/s
        EGR valve lift | % | u_egr_pct | %
        Nozzle ring pos. | % | u_vgt_pct | %
        Receiver press. | bara | p_im_pa | bar
        Exh. manifold press. | bara | p_em_pa | bar
        T/C speed | rpm | omega_t_rad_s | rpm of rad/s
        EGR flow | kg/s | w_egr_kg_s | kg/s
        Exh. temp. before turbine | °C | t_em_k | degC
        Exh. temp. after turbine | °C | t after | degC
        Air flow | kg/s | w_c_kg_s | kg/s
        Receiver temp. | °C | t_im_k | degC
        Baro. press. | mbar | p_amb_pa | mbar
        Lube oil temp. | °C | oil | degC""", row=True),
    file_of("a consultant's spreadsheet", """
        Time [s] | | time_s |
        Speed [rpm] | | n_e_rpm |
        Fuelling [mg/str] | | u_delta_mg |
        EGR valve lift [%] | | u_egr_pct | %
        VNT rack position [%] | | u_vgt_pct | %
        Inlet manifold pressure [kPa abs] | | p_im_pa | kPa
        Turbine inlet pressure [kPa abs] | | p_em_pa | kPa
        Turbine outlet pressure [kPa abs] | | p after | kPa
        TC speed [rpm] | | omega_t_rad_s | rpm of rad/s
        EGR mass flow [kg/hr] | | w_egr_kg_s | kg/h
        Turbine inlet temperature [degC] | | t_em_k | degC
        Turbine outlet temperature [degC] | | t after | degC
        Air mass flow [kg/hr] | | w_c_kg_s | kg/h
        Compressor outlet temperature [degC] | | t cooler | degC
        Inlet manifold temperature [degC] | | t_im_k | degC
        Cell pressure [kPa] | | p_amb_pa | kPa
        Cell temperature [degC] | | t_amb_k | degC"""),
)  # fmt: skip

# what a channel of another kind gives
LEADS_TO = {"fuel": "u_delta_mg", "egr rate": "w_egr_kg_s", "air per stroke": "w_c_kg_s", "mm3": "u_delta_mg"}
TO["fraction of 1"] = lambda x: x * 100.0


def written(file: Foreign, known: dict[str, Values]) -> str:
    """The file as CSV text."""
    columns = {}
    for name, (quantity, conversion) in file.channels.items():
        values = TO[conversion](known[quantity])
        columns[name] = values * 1e3 if file.units.get(name) == "ms" else values
    text = pd.DataFrame(columns).to_csv(index=False, sep=";", float_format="%.8g")
    if file.units:
        lines = text.split("\n")
        lines.insert(1, ";".join(file.units[name] for name in columns))
        text = "\n".join(lines)
    return text


def without_names(file: Foreign) -> Foreign:
    """The same channels and units in another order, under names that say nothing; time keeps its own."""
    time, *others = file.channels
    np.random.default_rng(len(others)).shuffle(others)
    names = {time: time} | {name: f"ch{k:02d}" for k, name in enumerate(others, 1)}
    units = {names[name]: file.units.get(name) or unit_in_name(name) or "" for name in names}
    return Foreign(file.title, {names[name]: file.channels[name] for name in names}, units)


def expected(file: Foreign) -> dict[str, str]:
    """Our column -> the channel that is it, without time."""
    endings = ("_rpm", "_mg", "_pct", "_pa", "_rad_s", "_kg_s", "_k", "_nm")
    leads = {LEADS_TO.get(quantity, quantity): name for name, (quantity, _) in file.channels.items()}
    return {column: name for column, name in leads.items() if column.endswith(endings)}
